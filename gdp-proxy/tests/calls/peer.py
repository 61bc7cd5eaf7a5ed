#!/usr/bin/env python3
"""An rclpy node as applications have them. Says what happens in lines of JSON.

peer.py NAME serve SERVICE           test_msgs/BasicTypes: int64_value is the sum of the request's int64_value and int32_value; says that it was asked
peer.py NAME call SERVICE A B [N]    the same, N times at once
peer.py NAME watch SERVICE           the same: says whenever it is there or gone
peer.py NAME switch SERVICE          std_srvs/SetBool: says what it was set to; at false it does not answer
peer.py NAME set SERVICE true|false  the same
peer.py NAME compute ACTION SECONDS  test_msgs/Fibonacci: so many seconds for each number, with feedback; may be cancelled, and rejects what is negative
peer.py NAME send ACTION ORDER [N]   the same; cancels after the N-th feedback
"""

import json
import os
import signal
import sys
import threading
import time

# Of every thread that comes, also of those that libraries make: one alone waits for it, in `end_at_interrupt`.
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
signal.signal(signal.SIGINT, signal.SIG_DFL)

import rclpy
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from std_srvs.srv import SetBool
from test_msgs.action import Fibonacci
from test_msgs.srv import BasicTypes

# For whatever is waited for. Says that it is broken, not how fast it is.
LIMIT = 30


def say(event, **what):
    # In one go: callbacks run in threads of their own.
    sys.stdout.write(json.dumps({"event": event, **what}) + "\n")
    sys.stdout.flush()


def serve(node, service):
    def answer(request, response):
        response.int64_value = request.int64_value + request.int32_value
        say("asked", sum=response.int64_value)
        response.string_value = node.get_name()
        return response

    node.create_service(BasicTypes, service, answer)
    say("ready")


def call(node, service, a, b, count="1"):
    client = node.create_client(BasicTypes, service)

    def ask():
        if not client.wait_for_service(LIMIT):
            return say("absent")
        calls = [client.call_async(BasicTypes.Request(int64_value=int(a) + i, int32_value=int(b))) for i in range(int(count))]
        for done in calls:
            response = result_of(done)
            say("response", sum=response.int64_value, server=response.string_value)

    threading.Thread(target=ask, daemon=True).start()


def watch(node, service):
    client = node.create_client(BasicTypes, service)

    def look():
        before = None
        while True:
            now = client.service_is_ready()
            if now != before:
                say("there" if now else "gone")
            before = now
            time.sleep(0.05)

    threading.Thread(target=look, daemon=True).start()


def switch(node, service):
    def answer(request, response):
        say("set", data=request.data)
        if not request.data:
            time.sleep(1000)
        response.success, response.message = True, "it is on"
        return response

    node.create_service(SetBool, service, answer)
    say("ready")


def set(node, service, value):
    client = node.create_client(SetBool, service)

    def ask():
        if not client.wait_for_service(LIMIT):
            return say("absent")
        response = result_of(client.call_async(SetBool.Request(data=value == "true")))
        say("response", success=response.success, message=response.message)

    threading.Thread(target=ask, daemon=True).start()


def compute(node, action, seconds):
    def run(goal):
        say("goal", order=goal.request.order)
        sequence = [0, 1]
        while len(sequence) < goal.request.order and rclpy.ok():
            if goal.is_cancel_requested:
                say("canceled")
                goal.canceled()
                return Fibonacci.Result(sequence=sequence)
            sequence.append(sequence[-1] + sequence[-2] & 0x7FFFFFFF)
            goal.publish_feedback(Fibonacci.Feedback(sequence=sequence))
            time.sleep(float(seconds))
        if rclpy.ok():
            goal.succeed()
        return Fibonacci.Result(sequence=sequence)

    group = ReentrantCallbackGroup()
    cancel = lambda goal: CancelResponse.ACCEPT
    take = lambda goal: GoalResponse.REJECT if goal.order < 0 else GoalResponse.ACCEPT
    callbacks = {"callback_group": group, "goal_callback": take, "cancel_callback": cancel}
    node.server = ActionServer(node, Fibonacci, action, run, **callbacks)
    say("ready")


def send(node, action, order, cancel_after="0"):
    client = ActionClient(node, Fibonacci, action)
    heard, goals = [], []

    def feedback(message):
        heard.append(len(message.feedback.sequence))
        say("feedback", length=heard[-1])
        if len(heard) == int(cancel_after):
            goals[0].cancel_goal_async().add_done_callback(
                lambda done: say("canceling", goals=len(done.result().goals_canceling))
            )

    def run():
        if not client.wait_for_server(LIMIT):
            return say("absent")
        say("there")
        goal = result_of(client.send_goal_async(Fibonacci.Goal(order=int(order)), feedback_callback=feedback))
        goals.append(goal)
        say("accepted" if goal.accepted else "rejected")
        if not goal.accepted:
            return
        result = result_of(goal.get_result_async())
        names = {
            GoalStatus.STATUS_SUCCEEDED: "succeeded",
            GoalStatus.STATUS_CANCELED: "canceled",
            GoalStatus.STATUS_ABORTED: "aborted",
        }
        # The topic of statuses is another than the answer.
        until = time.monotonic() + LIMIT
        while goal.status != result.status and time.monotonic() < until:
            time.sleep(0.02)
        shown = names.get(goal.status, goal.status)
        say("result", status=names.get(result.status, result.status), shown=shown, length=len(result.result.sequence))

    node.client = client
    threading.Thread(target=run, daemon=True).start()


def result_of(future):
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    done.wait()
    return future.result()


def end_at_interrupt(executor):
    signal.sigwait({signal.SIGINT})
    rclpy.try_shutdown()
    # The executor misses a single wake-up now and then, and rclpy's own handler gives no second one.
    while True:
        executor.wake()
        time.sleep(0.05)


if __name__ == "__main__":
    name, mode, *arguments = sys.argv[1:]
    rclpy.init(signal_handler_options=rclpy.SignalHandlerOptions.NO)
    node = rclpy.create_node(name)
    executor = MultiThreadedExecutor()
    executor.add_node(node)
    threading.Thread(target=end_at_interrupt, args=[executor], daemon=True).start()
    try:
        globals()[mode](node, *arguments)
        executor.spin()
    except ExternalShutdownException:
        pass
    finally:
        # Says goodbye, once nothing uses the node any more; but a callback may sleep on.
        executor.shutdown(2, wait_for_threads=False)
        if hasattr(node, "server"):
            node.server.destroy()
        node.destroy_node()
        sys.stdout.flush()
        os._exit(0)
