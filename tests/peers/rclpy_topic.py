"""An rclpy node that publishes or subscribes to std_msgs/msg/String. See README.md."""

import argparse
import json
import os
import sys
import time
import zlib

import rclpy
from std_msgs.msg import String


def arguments():
    p = argparse.ArgumentParser()
    p.add_argument("verb", choices=["talk", "listen"])
    p.add_argument("--topic", default="/chatter")
    p.add_argument("--count", type=int, default=0, help="0: until killed")
    p.add_argument("--rate", type=float, default=10)
    p.add_argument("--size", type=int, default=64)
    p.add_argument("--text", default="hello from the robot")
    p.add_argument("--gate", required=False, help="send warm-up messages, numbered -1, until this file exists")
    return p.parse_args()


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def talk(node, args):
    publisher = node.create_publisher(String, args.topic, 10)
    room = max(args.size - 43, 0)
    filler = (f"{args.text} " * (room // (len(args.text) + 1) + 1))[:room]
    crc = zlib.crc32(filler.encode())

    def write(sequence):
        publisher.publish(String(data=f"{sequence:010} {time.monotonic_ns():020} {crc:010} {filler}"))
        time.sleep(1 / args.rate)

    say(event="ready")
    while args.gate and not os.path.exists(args.gate):
        write(-1)
    sequence = 0
    while args.count == 0 or sequence < args.count:
        write(sequence)
        sequence += 1
    say(event="done", sent=args.count)


def listen(node, args):
    def receive(message):
        now = time.monotonic_ns()
        sequence, clock, crc, filler = message.data.split(" ", 3)
        intact = zlib.crc32(filler.encode()) == int(crc)
        latency = now - int(clock)
        say(event="message", seq=int(sequence), latency_ns=latency, bytes=len(message.data), intact=intact, text=filler[:40])

    node.create_subscription(String, args.topic, receive, 10)
    say(event="ready")


args = arguments()
rclpy.init()
node = rclpy.create_node("rclpy_" + args.verb)
{"talk": talk, "listen": listen}[args.verb](node, args)
rclpy.spin(node)
