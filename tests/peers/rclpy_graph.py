"""Prints the ROS graph through rclpy, as the commands of ros2cli read it. See README.md."""

import json
import sys
import time

import rclpy
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient


def endpoint(info):
    return {
        "node": f"{info.node_namespace.rstrip('/')}/{info.node_name}",
        "type": info.topic_type,
        "hash": str(info.topic_type_hash),
        "reliability": info.qos_profile.reliability.name,
        "durability": info.qos_profile.durability.name,
        "liveliness": info.qos_profile.liveliness.name,
    }


def described(node):
    """What `ros2 node list`, `node info`, `topic info -v` and `service list` show."""
    nodes, topics = {}, {}
    for name, namespace in node.get_node_names_and_namespaces():
        if name.startswith("graph_observer"):
            continue
        full = f"{namespace.rstrip('/')}/{name}"
        by = lambda get: dict(get(name, namespace))
        nodes[full] = {
            "publishers": by(node.get_publisher_names_and_types_by_node),
            "subscribers": by(node.get_subscriber_names_and_types_by_node),
            "servers": by(node.get_service_names_and_types_by_node),
        }
    for topic, _ in node.get_topic_names_and_types():
        topics[topic] = [endpoint(info) for info in node.get_publishers_info_by_topic(topic)]
    return {"event": "graph", "nodes": nodes, "topics": topics, "services": dict(node.get_service_names_and_types())}


def parameters(node, of):
    """What `ros2 param list`, `get`, `set` and `get` do, as soon as the node is there."""
    client = AsyncParameterClient(node, of)
    if not client.wait_for_services(timeout_sec=30):
        return {"event": "parameters", "error": "its services are not there"}

    def answer(future):
        rclpy.spin_until_future_complete(node, future, timeout_sec=30)
        return future.result()

    get = lambda: answer(client.get_parameters(["use_sim_time"])).values[0].bool_value
    names = sorted(answer(client.list_parameters([], 10)).result.names)
    before = get()
    changed = answer(client.set_parameters([Parameter("use_sim_time", value=True)])).results[0]
    return {"event": "parameters", "names": names, "use_sim_time": [before, get()], "reason": changed.reason}


rclpy.init()
observer = rclpy.create_node("graph_observer", start_parameter_services=False)
if sys.argv[1:]:
    print(json.dumps(parameters(observer, sys.argv[1])), flush=True)
while True:
    rclpy.spin_once(observer, timeout_sec=0.05)
    print(json.dumps(described(observer)), flush=True)
    time.sleep(0.2)
