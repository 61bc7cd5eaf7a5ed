"""An action server or client in a graph of rmw_zenoh, by eclipse-zenoh alone. See README.md.

The hashes of its types are those that rosidl has written beside the messages of the rclpy wheels.
"""

import argparse
import json
import os
import pathlib
import struct
import sys
import threading
import time

import zenoh

SHARE = pathlib.Path(sys.prefix) / "share"
SEND_GOAL = ("send_goal", "test_msgs/action/Fibonacci_SendGoal")
GET_RESULT = ("get_result", "test_msgs/action/Fibonacci_GetResult")
CANCEL_GOAL = ("cancel_goal", "action_msgs/srv/CancelGoal")
FEEDBACK = ("feedback", "test_msgs/action/Fibonacci_FeedbackMessage")
STATUS = ("status", "action_msgs/msg/GoalStatusArray")
SUCCEEDED = 4
HEAD = b"\0\1\0\0"
DEFAULT, LATCHED = "::,10:,:,:,,", ":1:,1:,:,:,,"


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def hashes():
    found = {}
    for file in ("test_msgs/action/Fibonacci", "action_msgs/srv/CancelGoal", "action_msgs/msg/GoalStatusArray"):
        for entry in json.loads((SHARE / f"{file}.json").read_text())["type_hashes"]:
            found[entry["type_name"]] = entry["hash_string"]
    return found


class Node:
    def __init__(self, port, action, name):
        config = zenoh.Config()
        for key, value in [
            ("mode", '"client"'),
            ("connect/endpoints", f'["tcp/127.0.0.1:{port}"]'),
            ("scouting/multicast/enabled", "false"),
            ("timestamping/enabled", "true"),
        ]:
            config.insert_json5(key, value)
        self.session = zenoh.open(config)
        self.action, self.name, self.hashes, self.number = action, name, hashes(), 0
        self.tokens = [self.declare(f"{self.head(1)}/NN/%/%/{name}")]

    def head(self, number):
        return f"@ros2_lv/0/{self.session.info.zid()}/1/{number}"

    def declare(self, token):
        return self.session.liveliness().declare_token(token)

    def endpoint(self, role, part, qos=DEFAULT):
        """Announces one part of the action; returns its key."""
        name, kind = part
        package, folder, rest = kind.split("/")
        dds, name = f"{package}::{folder}::dds_::{rest}_", f"{self.action}/_action/{name}"
        number = len(self.tokens) + 1
        mangled = name.replace("/", "%")
        token = f"{self.head(number)}/{role}/%/%/{self.name}/{mangled}/{dds}/{self.hashes[kind]}/{qos}"
        self.tokens.append(self.declare(token))
        return f"0{name}/{dds}/{self.hashes[kind]}"

    def attachment(self):
        self.number += 1
        return struct.pack("<qqB", self.number, time.time_ns(), 16) + bytes(16)

    def serve(self, part, answer):
        key = self.endpoint("SS", part)

        def asked(query):
            attachment = query.attachment.to_bytes()
            assert len(attachment) == 33, attachment
            reply = answer(query.payload.to_bytes()[4:])
            query.reply(key, HEAD + reply, attachment=attachment[:8] + struct.pack("<q", time.time_ns()) + attachment[16:])

        return self.session.declare_queryable(key, asked, complete=True)

    def call(self, part, request):
        key = self.endpoint("SC", part)
        while True:
            options = {"target": zenoh.QueryTarget.ALL_COMPLETE, "consolidation": zenoh.ConsolidationMode.NONE}
            attachment = self.attachment()
            for reply in self.session.get(key, payload=HEAD + request, attachment=attachment, timeout=60, **options):
                if reply.ok:
                    theirs = reply.ok.attachment.to_bytes()
                    assert theirs[:8] == attachment[:8] and theirs[16:] == attachment[16:], theirs
                    return reply.ok.payload.to_bytes()[4:]
            time.sleep(0.2)


def fibonacci(order):
    sequence = [0, 1]
    while len(sequence) < order:
        sequence.append(sequence[-1] + sequence[-2])
        yield sequence


def integers(sequence):
    return struct.pack(f"<I{len(sequence)}i", len(sequence), *sequence)


def compute(node):
    advanced = {"cache": zenoh.ext.CacheConfig(1), "publisher_detection": True}
    feedback = node.session.declare_publisher(node.endpoint("MP", FEEDBACK))
    status = zenoh.ext.declare_advanced_publisher(node.session, node.endpoint("MP", STATUS, LATCHED), **advanced)
    goals = {}

    def show(goal, state):
        message = struct.pack("<I16siIb", 1, goal, 0, 0, state)
        status.put(HEAD + message, attachment=node.attachment())

    def run(goal, order):
        sequence = [0, 1]
        for sequence in fibonacci(order):
            time.sleep(0.1)
            feedback.put(HEAD + goal + integers(sequence), attachment=node.attachment())
        show(goal, SUCCEEDED)
        goals[goal][1].append(sequence)
        goals[goal][0].set()

    def send_goal(request):
        goal, order = struct.unpack_from("<16si", request)
        say(event="goal", order=order)
        goals[goal] = (threading.Event(), [])
        show(goal, 2)
        threading.Thread(target=run, args=(goal, order), daemon=True).start()
        return struct.pack("<B3xiI", 1, 0, 0)

    def get_result(request):
        done, result = goals[request[:16]]
        done.wait()
        return struct.pack("<b3x", SUCCEEDED) + integers(result[0])

    def cancel_goal(_):
        return struct.pack("<b3xI", 1, 0)

    served = [node.serve(*it) for it in ((SEND_GOAL, send_goal), (CANCEL_GOAL, cancel_goal))]
    # A result takes its time, and Zenoh calls back in one thread for each queryable.
    return [*served, node.serve(GET_RESULT, get_result), feedback, status]


def send(node, order):
    goal = os.urandom(16)

    def feedback(sample):
        message = sample.payload.to_bytes()[4:]
        if message[:16] == goal:
            say(event="feedback", length=struct.unpack_from("<I", message, 16)[0])

    def status(sample):
        message = sample.payload.to_bytes()[4:]
        count = struct.unpack_from("<I", message)[0]
        states = {message[4 + 28 * i : 20 + 28 * i]: message[28 + 28 * i] for i in range(count)}
        if goal in states:
            say(event="status", status=states[goal])

    history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
    subscribers = [
        node.session.declare_subscriber(node.endpoint("MS", FEEDBACK), feedback),
        zenoh.ext.declare_advanced_subscriber(node.session, node.endpoint("MS", STATUS, LATCHED), status, history=history),
    ]
    answer = node.call(SEND_GOAL, struct.pack("<16si", goal, order))
    say(event="accepted" if answer[0] else "rejected")
    answer = node.call(GET_RESULT, goal)
    status, length = struct.unpack_from("<b3xI", answer)
    say(event="result", status=status, length=length)
    return subscribers


p = argparse.ArgumentParser()
p.add_argument("verb", choices=["compute", "send"])
p.add_argument("--port", type=int, required=True)
p.add_argument("--action", default="/fibonacci")
p.add_argument("--order", type=int, default=10)
args = p.parse_args()
node = Node(args.port, args.action, args.verb)
if args.verb == "compute":
    alive = compute(node)
    say(event="ready")
else:
    alive = send(node, args.order)
while True:
    time.sleep(60)
