#!/usr/bin/env python3
"""An rclpy server or client of std_srvs/SetBool that measures calls. Output: lines of JSON.

rclpy_calls.py serve SERVICE LABEL     answers each call with the label
rclpy_calls.py call SERVICE COUNT HZ   calls at a fixed rate, and reports each time from when the call was due
"""

import json
import signal
import sys
import threading
import time

signal.signal(signal.SIGTERM, signal.SIG_DFL)

import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import SetBool

# For what is waited for before the measurement, and for the last responses, in seconds.
LIMIT = 30

# Calls before the measurement, one after the other.
WARM_UP = 20


def say(event, **what):
    sys.stdout.write(json.dumps({"event": event, **what}) + "\n")
    sys.stdout.flush()


def serve(node, service, label):
    def answer(request, response):
        response.success, response.message = True, label
        return response

    node.create_service(SetBool, service, answer)
    say("ready")


def call(node, service, count, hertz):
    client = node.create_client(SetBool, service)
    taken, labels, lock = [], {}, threading.Lock()

    def received(due):
        def note(done):
            now = time.monotonic()
            with lock:
                taken.append(round((now - due) * 1e6))
                label = done.result().message
                labels[label] = labels.get(label, 0) + 1

        return note

    def run():
        if not client.wait_for_service(LIMIT):
            return say("absent")
        for _ in range(WARM_UP):
            done = threading.Event()
            client.call_async(SetBool.Request(data=True)).add_done_callback(lambda _: done.set())
            done.wait(LIMIT)
        begin = time.monotonic()
        for i in range(int(count)):
            due = begin + i / float(hertz)
            time.sleep(max(0, due - time.monotonic()))
            client.call_async(SetBool.Request(data=True)).add_done_callback(received(due))
        deadline = time.monotonic() + LIMIT
        while len(taken) < int(count) and time.monotonic() < deadline:
            time.sleep(0.01)
        with lock:
            say("done", taken_us=taken, labels=labels)

    threading.Thread(target=run, daemon=True).start()


def main():
    verb, *arguments = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node(f"{verb}_calls", enable_rosout=False, start_parameter_services=False)
    {"serve": serve, "call": call}[verb](node, *arguments)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.spin()


main()
