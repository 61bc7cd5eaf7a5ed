"""The edge: collects the parts of a request, computes, and replies.

Warm-up requests are answered at once, without computing.
"""

import time

import workloads
from cdr import MessageError, digest
from messages import WARM_UP
from node import Node, SendError
from report import Report

#: Incomplete requests to keep; the oldest is dropped. The readers' history has the same depth.
PENDING = 10


class Collector:
    """Collects the parts of requests by request number."""

    def __init__(self, kinds):
        self.kinds = kinds
        self.pending = {}

    def add(self, received):
        """Returns the parts in the order of the topics and the last one's receipt time, or None."""
        message, content = self.kinds[received.topic].decode(received.payload)
        parts = self.pending.setdefault(message.number, {})
        parts[received.topic] = (message, content, received.at)
        if len(parts) < len(self.kinds):
            if len(self.pending) > PENDING:
                del self.pending[next(iter(self.pending))]
            return None
        del self.pending[message.number]
        messages, contents, times = zip(*(parts[topic] for topic in self.kinds))
        return messages, contents, max(times)


def main():
    options = workloads.parser(__doc__).parse_args()
    report = Report()
    workload = workloads.load(options)
    topic, kind = workload.REPLY
    edge = workload.Edge(options)
    node = Node("eval_edge", reads=workload.REQUESTS, writes={topic: kind})
    collector = Collector(workload.REQUESTS)
    report("ready")
    while True:
        received = node.receive(timeout=1)
        if received is None:
            continue
        try:
            complete = collector.add(received)
            if complete:
                answer(node, edge, topic, complete, report)
        except (MessageError, SendError) as error:
            report("error", topic=received.topic, error=str(error))


def answer(node, edge, topic, complete, report):
    messages, contents, received = complete
    number = messages[0].number
    if number == WARM_UP:
        node.publish(topic, edge.answer_warm_up(number).encode())
        return
    reply = edge.compute(*messages).encode()
    replied = time.monotonic_ns()
    node.publish(topic, reply)
    report(
        "compute",
        id=number,
        received=received,
        replied=replied,
        digest=digest(contents),
        reply_digest=digest([reply.content]),
    )


if __name__ == "__main__":
    main()
