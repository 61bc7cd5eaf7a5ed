"""An rclpy node that serves or calls std_srvs/srv/SetBool. See README.md."""

import argparse
import json
import sys
import threading
import time

import rclpy
from rclpy.executors import ExternalShutdownException
from std_srvs.srv import SetBool


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def switch(node, service):
    def answer(request, response):
        response.success, response.message = request.data, f"{service} is {'on' if request.data else 'off'}"
        return response

    node.create_service(SetBool, service, answer)
    say(event="ready")


def set(node, *services):
    clients = {service: node.create_client(SetBool, service) for service in services}

    def ask():
        for service, client in clients.items():
            client.wait_for_service()
            for value in [True, False]:
                response = client.call(SetBool.Request(data=value))
                say(event="response", service=service, success=response.success, message=response.message)
        while clients:
            for service in [service for service, client in clients.items() if not client.service_is_ready()]:
                say(event="gone", service=service)
                del clients[service]
            time.sleep(0.05)

    threading.Thread(target=ask, daemon=True).start()


p = argparse.ArgumentParser()
p.add_argument("verb", choices=["switch", "set"])
p.add_argument("--service", nargs="+")
args = p.parse_args()
rclpy.init()
node = rclpy.create_node(args.verb)
try:
    globals()[args.verb](node, *args.service)
    rclpy.spin(node)
except ExternalShutdownException:
    # Announces the node's departure.
    node.destroy_node()
