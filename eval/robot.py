"""The robot: sends requests, waits for replies, and reports times and the workload's result."""

import os
import signal
import time
from dataclasses import dataclass

import workloads
from cdr import MessageError, digest
from messages import WARM_UP
from node import Node, SendError
from report import Report

#: Between warm-up requests, in seconds: first and most. It doubles, because on a slow link each new
#: message of a full history replaces one that has not arrived yet.
WARM_UP_PERIOD, LONGEST_WARM_UP_PERIOD = 0.1, 3.2
#: When no reply has come for as long, in seconds, the warm-up is over.
WARM_UP_SILENCE = 0.5
#: After this many seconds without a reply, a request of a closed loop is lost.
REPLY_TIMEOUT = 10.0
#: The time for replies that are outstanding when the last request has been sent.
FINAL_TIMEOUT = 5.0
#: Between a reply and the next request of a closed loop. The edge computes its digests meanwhile.
PAUSE = 0.02
#: Requests per second of an open loop.
RATE = 10.0


@dataclass(frozen=True)
class Request:
    number: int
    #: Encoded messages in the order of the workload's topics.
    parts: list
    digest: str


def main():
    parser = workloads.parser(__doc__)
    parser.add_argument("--count", type=int, required=True, help="requests to send")
    parser.add_argument("--rate", type=float, help="requests per second; closed loops: at most")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--gate", help="send no request until this file exists")
    parser.add_argument("--stay", action="store_true", help="after the last event, wait to be killed")
    parser.add_argument("--bytes", type=int, default=64, help="size of the image of `echo`")
    options = parser.parse_args()
    report = Report()
    workload = workloads.load(options)
    robot = Robot(workload, options, report)
    report("ready")
    robot.warm_up()
    report("matched")
    while options.gate and not os.path.exists(options.gate):
        time.sleep(0.01)
    if workload.OPEN_LOOP:
        robot.run_open(options.count, options.rate or RATE)
    else:
        robot.run_closed(options.count, options.rate)
    lost = options.count - len(robot.replies)
    report("done", lost=lost, **robot.workload.result(robot.replies))
    # What this process has used can be read while it exists.
    while options.stay:
        signal.pause()


class Robot:
    def __init__(self, workload, options, report):
        self.workload = workload.Robot(options)
        self.topics = list(workload.REQUESTS)
        self.reply_topic, self.reply_kind = workload.REPLY
        self.report = report
        reads = {self.reply_topic: self.reply_kind}
        self.node = Node("eval_robot", reads=reads, writes=workload.REQUESTS)
        #: Request number: reply.
        self.replies = {}

    def warm_up(self):
        """Returns when the whole path to the edge and back has carried messages."""
        while not self.node.matched():
            time.sleep(0.01)
        parts = self.prepare(WARM_UP).parts
        period = WARM_UP_PERIOD
        self.write(parts)
        while not self.next_reply(period):
            period = min(2 * period, LONGEST_WARM_UP_PERIOD)
            self.write(parts)
        # Late warm-up replies must not meet the first request.
        while self.next_reply(WARM_UP_SILENCE):
            pass

    def run_closed(self, count, rate):
        for number in range(count):
            request = self.prepare(number)
            start = time.monotonic()
            if self.send(request):
                deadline = start + REPLY_TIMEOUT
                while number not in self.replies and time.monotonic() < deadline:
                    self.handle_reply(deadline - time.monotonic(), awaited=[number])
            time.sleep(PAUSE)
            if rate:
                time.sleep(max(0.0, start + 1 / rate - time.monotonic()))

    def run_open(self, count, rate):
        # `start` leaves time for the preparation of the first request.
        start, sent = time.monotonic() + 0.1, set()
        for number in range(count):
            request = self.prepare(number)
            due = start + number / rate
            while (wait := due - time.monotonic()) > 0:
                self.handle_reply(wait, awaited=sent)
            if self.send(request):
                sent.add(number)
        deadline = time.monotonic() + FINAL_TIMEOUT
        while len(self.replies) < len(sent) and time.monotonic() < deadline:
            self.handle_reply(deadline - time.monotonic(), awaited=sent)

    def prepare(self, number):
        """Encodes a request and computes its digest, so that neither is in the timed interval."""
        parts = [message.encode() for message in self.workload.request(number)]
        return Request(number, parts, digest(part.content for part in parts))

    def send(self, request):
        """Sends a request and reports it. Returns whether DDS accepted all its parts."""
        sent = time.monotonic_ns()
        accepted = self.write(request.parts)
        size = sum(part.size for part in request.parts)
        self.report("request", id=request.number, sent=sent, bytes=size, digest=request.digest)
        return accepted

    def write(self, parts):
        try:
            for topic, part in zip(self.topics, parts):
                self.node.publish(topic, part)
            return True
        except SendError as error:
            self.report("error", error=str(error))
            return False

    def handle_reply(self, timeout, awaited):
        """Waits for a message, and keeps and reports it if it is a reply to an awaited request."""
        reply = self.next_reply(timeout)
        if reply is None:
            return
        message, content, received = reply
        if message.number not in awaited or message.number in self.replies:
            self.report("ignored", id=message.number, received=received)
            return
        self.replies[message.number] = message
        fields = {"received": received, "bytes": len(content), "digest": digest([content])}
        self.report("reply", id=message.number, **fields)

    def next_reply(self, timeout):
        """Returns message, content and receipt time, or None after `timeout` seconds."""
        received = self.node.receive(timeout)
        if received is None:
            return None
        try:
            return *self.reply_kind.decode(received.payload), received.at
        except MessageError as error:
            self.report("error", topic=received.topic, error=str(error))
            return None


if __name__ == "__main__":
    main()
