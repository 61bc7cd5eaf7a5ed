#!/usr/bin/env python3
"""A rospy node that serves or calls std_srvs/SetBool. See README.md."""

import argparse
import json
import sys

import rospy
import rosservice
from std_srvs.srv import SetBool, SetBoolResponse


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def switch(service):
    answer = lambda request: SetBoolResponse(request.data, f"{service} is {'on' if request.data else 'off'}")
    rospy.Service(service, SetBool, answer)
    say(event="ready")
    rospy.spin()


def set(*services):
    for service in services:
        rospy.wait_for_service(service)
        call = rospy.ServiceProxy(service, SetBool)
        for value in [True, False]:
            response = call(value)
            say(event="response", service=service, success=response.success, message=response.message)
    left = list(services)
    while left:
        for service in [service for service in left if not rosservice.get_service_uri(service)]:
            say(event="gone", service=service)
            left.remove(service)
        rospy.sleep(0.05)
    rospy.spin()


p = argparse.ArgumentParser()
p.add_argument("verb", choices=["switch", "set"])
p.add_argument("--service", nargs="+")
args = p.parse_args()
rospy.init_node(args.verb, disable_rosout=True)
globals()[args.verb](*args.service)
