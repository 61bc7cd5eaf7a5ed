"""`ros2 topic echo` and `ros2 topic pub` with rclpy alone, because no wheel has ros2cli. See README.md."""

import argparse
import importlib
import time

import rclpy
import yaml


def arguments():
    p = argparse.ArgumentParser(prog="ros2")
    topic = p.add_subparsers(dest="command", required=True).add_parser("topic").add_subparsers(dest="verb", required=True)
    echo = topic.add_parser("echo")
    pub = topic.add_parser("pub")
    for verb in echo, pub:
        verb.add_argument("-1", "--once", action="store_true")
        verb.add_argument("topic")
    pub.add_argument("type")
    pub.add_argument("values")
    return p.parse_args()


def message_type(name):
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def fields(message):
    return {name: getattr(message, name) for name in message.get_fields_and_field_types()}


def echo(node, args):
    known = {}
    while args.topic not in known:
        rclpy.spin_once(node, timeout_sec=0.1)
        known = dict(node.get_topic_names_and_types())
    done = []

    def receive(message):
        print(yaml.safe_dump(fields(message)) + "---", flush=True)
        done.append(args.once)

    node.create_subscription(message_type(known[args.topic][0]), args.topic, receive, 10)
    while True not in done:
        rclpy.spin_once(node, timeout_sec=0.1)


def pub(node, args):
    message = message_type(args.type)(**yaml.safe_load(args.values))
    publisher = node.create_publisher(type(message), args.topic, 10)
    while args.once and publisher.get_subscription_count() == 0:
        rclpy.spin_once(node, timeout_sec=0.1)
    print("publisher: beginning loop", flush=True)
    number = 1
    while True:
        publisher.publish(message)
        print(f"publishing #{number}: {message!r}\n", flush=True)
        number += 1
        if args.once:
            time.sleep(1)
            return
        time.sleep(1)


args = arguments()
rclpy.init()
try:
    {"echo": echo, "pub": pub}[args.verb](rclpy.create_node("ros2cli"), args)
except KeyboardInterrupt:
    pass
