#!/usr/bin/env python3
"""A rospy node that publishes or subscribes to std_msgs/String. See README.md."""

import argparse
import json
import os
import sys
import time
import zlib

import rospy
from std_msgs.msg import String


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def talk(args):
    publisher = rospy.Publisher(args.topic, String, queue_size=10, latch=args.transient_local)
    room = max(args.size - 43, 0)
    filler = (f"{args.text} " * (room // (len(args.text) + 1) + 1))[:room]
    crc = zlib.crc32(filler.encode())
    say(event="ready")
    sequence = -1 if args.gate else 0
    while args.count == 0 or sequence < args.count:
        if sequence < 0 and os.path.exists(args.gate):
            sequence = 0
        publisher.publish(f"{sequence:010} {time.monotonic_ns():020} {crc:010} {filler}")
        sequence += sequence >= 0
        time.sleep(1 / args.rate)
    say(event="done", sent=args.count)
    rospy.spin()


def listen(args):
    def receive(message):
        now = time.monotonic_ns()
        sequence, clock, crc, filler = message.data.split(" ", 3)
        intact = zlib.crc32(filler.encode()) == int(crc)
        latency = now - int(clock)
        say(event="message", seq=int(sequence), latency_ns=latency, bytes=len(message.data), intact=intact, text=filler[:40])

    rospy.Subscriber(args.topic, String, receive)
    say(event="ready")
    rospy.spin()


p = argparse.ArgumentParser()
p.add_argument("verb", choices=["talk", "listen"])
p.add_argument("--topic", default="/chatter")
p.add_argument("--count", type=int, default=0, help="0: until killed")
p.add_argument("--rate", type=float, default=10)
p.add_argument("--size", type=int, default=64)
p.add_argument("--text", default="hello from the robot")
p.add_argument("--gate", help="send warm-up messages, numbered -1, until this file exists")
p.add_argument("--transient-local", action="store_true", help="latch")
p.add_argument("--no-wait", action="store_true", help="a talker of rospy never waits")
args = p.parse_args()
rospy.init_node(f"{args.verb}_{os.getpid()}", disable_rosout=True)
{"talk": talk, "listen": listen}[args.verb](args)
