"""An rclpy node that publishes or subscribes to std_msgs/msg/String. See README.md."""

import argparse
import json
import os
import sys
import time
import zlib

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile
from std_msgs.msg import String


def arguments():
    p = argparse.ArgumentParser()
    p.add_argument("verb", choices=["talk", "listen"])
    p.add_argument("--topic", default="/chatter")
    p.add_argument("--node", help="namespace and name of the node, such as /robot/driver")
    p.add_argument("--count", type=int, default=0, help="0: until killed")
    p.add_argument("--rate", type=float, default=10)
    p.add_argument("--size", type=int, default=64)
    p.add_argument("--text", default="hello from the robot")
    p.add_argument("--gate", required=False, help="send warm-up messages, numbered -1, until this file exists")
    p.add_argument("--no-wait", action="store_true", help="a talker of rclpy never waits")
    p.add_argument("--transient-local", action="store_true")
    p.add_argument("--depth", type=int, default=10)
    p.add_argument("--lease", type=int, help="liveliness lease in milliseconds")
    p.add_argument("--manual", action="store_true", help="liveliness by topic; the talker asserts it until the gate is there")
    return p.parse_args()


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def qos(args):
    durability = DurabilityPolicy.TRANSIENT_LOCAL if args.transient_local else DurabilityPolicy.VOLATILE
    profile = QoSProfile(depth=args.depth, durability=durability)
    if args.lease:
        profile.liveliness = LivelinessPolicy.MANUAL_BY_TOPIC if args.manual else LivelinessPolicy.AUTOMATIC
        profile.liveliness_lease_duration = Duration(nanoseconds=args.lease * 1_000_000)
    return profile


def talk(node, args):
    publisher = node.create_publisher(String, args.topic, qos(args))
    room = max(args.size - 43, 0)
    filler = (f"{args.text} " * (room // (len(args.text) + 1) + 1))[:room]
    crc = zlib.crc32(filler.encode())

    def write(sequence):
        publisher.publish(String(data=f"{sequence:010} {time.monotonic_ns():020} {crc:010} {filler}"))
        time.sleep(1 / args.rate)

    say(event="ready")
    while args.gate and not os.path.exists(args.gate):
        if args.manual:
            publisher.assert_liveliness()
            time.sleep(args.lease / 3000)
        else:
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

    def liveliness(status):
        say(event="liveliness", alive=status.alive_count, not_alive=status.not_alive_count)

    callbacks = SubscriptionEventCallbacks(liveliness=liveliness if args.lease else None)
    node.create_subscription(String, args.topic, receive, qos(args), event_callbacks=callbacks)
    say(event="ready")


args = arguments()
rclpy.init()
namespace, _, name = (args.node or "rclpy_" + args.verb).rpartition("/")
node = rclpy.create_node(name, namespace=namespace or None)
node.get_logger().info(f"{args.node or args.verb} is ready")
{"talk": talk, "listen": listen}[args.verb](node, args)
rclpy.spin(node)
