"""A node with a life cycle, and a client that drives it as `ros2 lifecycle` does. See README.md."""

import json
import sys
import time

import rclpy
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.lifecycle import Node, TransitionCallbackReturn


def say(**fields):
    print(json.dumps(fields), flush=True)


class Driver(Node):
    def on_configure(self, state):
        say(event="configured")
        return TransitionCallbackReturn.SUCCESS


def serve(full):
    namespace, _, name = full.rpartition("/")
    node = Driver(name, namespace=namespace or None)
    say(event="ready")
    rclpy.spin(node)


def call(node, kind, service, request):
    client = node.create_client(kind, service)
    client.wait_for_service(timeout_sec=30)
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=30)
    return future.result()


def drive(full, transition):
    """Finds the node by its services, as `ros2 lifecycle nodes`, and then does `get`, `set` and `get`."""
    node = rclpy.create_node("operator", start_parameter_services=False)
    namespace, _, name = full.rpartition("/")
    found = {}
    for _ in range(600):
        try:
            found = dict(node.get_service_names_and_types_by_node(name, namespace or "/"))
        except rclpy._rclpy_pybind11.NodeNameNonExistentError:
            pass
        if f"{full}/change_state" in found:
            break
        time.sleep(0.05)
    say(event="found", types=found.get(f"{full}/get_state", []))
    state = lambda: call(node, GetState, f"{full}/get_state", GetState.Request()).current_state.label
    say(event="state", label=state())
    request = ChangeState.Request()
    request.transition.label = transition
    say(event="changed", success=call(node, ChangeState, f"{full}/change_state", request).success)
    say(event="state", label=state())


rclpy.init()
{"serve": serve, "drive": drive}[sys.argv[1]](*sys.argv[2:])
