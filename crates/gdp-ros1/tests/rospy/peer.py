#!/usr/bin/env python3
"""A rospy node as applications have them. Says what happens in lines of JSON.

peer.py NAME publish TOPIC TEXT     std_msgs/String, 20 a second: "TEXT 0", "TEXT 1", …
peer.py NAME latch TOPIC TEXT       std_msgs/String, once
peer.py NAME once TOPIC TEXT        std_msgs/String, once as soon as somebody is connected, and ends
peer.py NAME publish-image TOPIC N  sensor_msgs/Image of N bytes, once, latched
peer.py NAME publish-many PREFIX N  std_msgs/String on N topics, PREFIX0 and so on; says so after each 1000
peer.py NAME listen TOPIC           std_msgs/String
peer.py NAME listen-image TOPIC     sensor_msgs/Image
peer.py NAME serve SERVICE          std_srvs/SetBool: says what it was set to, and fails at false
peer.py NAME hang-up SERVICE        std_srvs/SetBool: hangs up on the first call, and answers the others
peer.py NAME act ACTION             actionlib/TestAction: counts to the goal, and the result is twice the goal
peer.py NAME ask ACTION GOAL        actionlib/TestAction: waits for the server as applications do, and sends a goal
peer.py NAME compute ACTION PACKAGE SECONDS  PACKAGE/FibonacciAction: so many seconds for each number, with feedback; may be
                                    cancelled, and rejects what is negative; several goals at once
peer.py NAME send ACTION PACKAGE ORDER [N [HOW]]  the same; after the N-th feedback cancels its `goal`, `all` or what is `before` now
peer.py NAME crowd NODE TOPIC N     N connections to a publisher, which say nothing and are opened again when they end
peer.py NAME nodes                  names of all nodes at the master
peer.py NAME call SERVICE true|false[,…]  std_srvs/SetBool, once or several times over one connection
"""

import hashlib
import json
import resource
import select
import socket
import struct
import sys
import threading
import xmlrpc.client
from io import BytesIO

import actionlib
import genpy.dynamic
import rosgraph
import rospy
from actionlib_msgs.msg import GoalStatus
from actionlib.msg import TestAction, TestFeedback, TestGoal, TestResult
from rosgraph.network import read_ros_handshake_header, write_ros_handshake_header
from sensor_msgs.msg import Image
from std_msgs.msg import String
from std_srvs.srv import SetBool, SetBoolResponse


def say(event, **what):
    # In one go: callbacks run in threads of their own.
    sys.stdout.write(json.dumps({"event": event, **what}) + "\n")
    sys.stdout.flush()


def digest(data):
    return hashlib.sha256(data).hexdigest()


def publish(topic, text):
    publisher = rospy.Publisher(topic, String, queue_size=10)
    rate, n = rospy.Rate(20), 0
    say("ready")
    while not rospy.is_shutdown():
        publisher.publish(f"{text} {n}")
        n += 1
        rate.sleep()


def latch(topic, text):
    publisher = rospy.Publisher(topic, String, queue_size=1, latch=True)
    publisher.publish(text)
    say("ready")
    rospy.spin()


def once(topic, text):
    publisher = rospy.Publisher(topic, String, queue_size=1)
    while publisher.get_num_connections() == 0:
        rospy.sleep(0.01)
    publisher.publish(text)
    rospy.sleep(0.1)


def publish_image(topic, size):
    image = Image(height=1, width=int(size), encoding="mono8", step=int(size))
    image.header.frame_id = "camera"
    image.data = bytes(i * 31 % 256 for i in range(256)) * (int(size) // 256)
    publisher = rospy.Publisher(topic, Image, queue_size=1, latch=True)
    publisher.publish(image)
    say("ready", sha256=digest(image.data))
    rospy.spin()


def publish_many(prefix, count):
    publishers = []
    for n in range(int(count)):
        publishers.append(rospy.Publisher(f"{prefix}{n}", String, queue_size=1))
        if (n + 1) % 1000 == 0:
            say("published", topics=n + 1)
    rospy.spin()


def listen(topic):
    heard = lambda message: say("message", data=message.data, caller=message._connection_header["callerid"])
    rospy.Subscriber(topic, String, heard)
    say("ready")
    rospy.spin()


def listen_image(topic):
    heard = lambda image: say("message", size=len(image.data), sha256=digest(image.data), frame=image.header.frame_id)
    rospy.Subscriber(topic, Image, heard)
    say("ready")
    rospy.spin()


def serve(service):
    def answer(request):
        if not request.data:
            raise ValueError("it stays on")
        return SetBoolResponse(True, "it is on")

    rospy.Service(service, SetBool, answer)
    say("ready")
    rospy.spin()


def hang_up(service):
    listener = socket.create_server(("localhost", 0))
    address = f"rosrpc://localhost:{listener.getsockname()[1]}"
    rosgraph.Master(rospy.get_name()).registerService(service, address, rospy.get_node_uri())
    say("ready")
    calls = 0
    while not rospy.is_shutdown():
        connection, _ = listener.accept()
        with connection:
            asked = read_ros_handshake_header(connection, BytesIO(), 4096)
            fields = {"callerid": rospy.get_name(), "service": service, "type": SetBool._type, "md5sum": SetBool._md5sum}
            write_ros_handshake_header(connection, fields)
            if asked.get("probe") == "1":
                continue
            connection.recv(4 + 1)
            calls += 1
            if calls == 1:
                continue
            response = BytesIO()
            SetBoolResponse(True, "it is on").serialize(response)
            connection.sendall(struct.pack("<BI", 1, response.tell()) + response.getvalue())


def act(action):
    def execute(goal):
        for n in range(goal.goal):
            server.publish_feedback(TestFeedback(feedback=n))
            # Longer in all than a new connection takes: feedback is not latched.
            rospy.sleep(0.2)
        server.set_succeeded(TestResult(result=2 * goal.goal))

    server = actionlib.SimpleActionServer(action, TestAction, execute, auto_start=False)
    server.start()
    say("ready")
    rospy.spin()


def ask(action, goal):
    client = actionlib.SimpleActionClient(action, TestAction)
    say("server", found=client.wait_for_server(rospy.Duration(30)))
    client.send_goal(TestGoal(goal=int(goal)), feedback_cb=lambda feedback: say("feedback", n=feedback.feedback))
    finished = client.wait_for_result(rospy.Duration(30))
    say("result", finished=finished, state=client.get_state(), result=getattr(client.get_result(), "result", None))


# As genaction makes them of an `.action` file.
FIBONACCI = """FibonacciActionGoal action_goal
FibonacciActionResult action_result
FibonacciActionFeedback action_feedback
MSG: {package}/FibonacciActionGoal
Header header
actionlib_msgs/GoalID goal_id
FibonacciGoal goal
MSG: {package}/FibonacciActionResult
Header header
actionlib_msgs/GoalStatus status
FibonacciResult result
MSG: {package}/FibonacciActionFeedback
Header header
actionlib_msgs/GoalStatus status
FibonacciFeedback feedback
MSG: {package}/FibonacciGoal
int32 order
MSG: {package}/FibonacciResult
int32[] sequence
MSG: {package}/FibonacciFeedback
int32[] sequence
MSG: actionlib_msgs/GoalID
time stamp
string id
MSG: actionlib_msgs/GoalStatus
GoalID goal_id
uint8 status
uint8 PENDING=0
uint8 ACTIVE=1
uint8 PREEMPTED=2
uint8 SUCCEEDED=3
uint8 ABORTED=4
uint8 REJECTED=5
uint8 PREEMPTING=6
uint8 RECALLING=7
uint8 RECALLED=8
uint8 LOST=9
string text
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""


def fibonacci(package):
    """The classes of PACKAGE/FibonacciAction and of what it consists of, by their names behind `Fibonacci`."""
    text = FIBONACCI.format(package=package).replace("MSG: ", "=" * 80 + "\nMSG: ")
    classes = genpy.dynamic.generate_dynamic(f"{package}/FibonacciAction", text)
    return {part: classes[f"{package}/Fibonacci{part}"] for part in ["Action", "Goal", "Result", "Feedback"]}


def compute(action, package, seconds):
    classes = fibonacci(package)

    def run(goal):
        order, sequence = goal.get_goal().order, [0, 1]
        say("goal", order=order)
        while len(sequence) < order and not rospy.is_shutdown():
            if goal.get_goal_status().status == GoalStatus.PREEMPTING:
                say("canceled")
                return goal.set_canceled(classes["Result"](sequence=sequence))
            sequence.append(sequence[-1] + sequence[-2] & 0x7FFFFFFF)
            goal.publish_feedback(classes["Feedback"](sequence=sequence))
            rospy.sleep(float(seconds))
        goal.set_succeeded(classes["Result"](sequence=sequence), "it is long enough")

    def take(goal):
        if goal.get_goal().order < 0:
            return goal.set_rejected(None, "it counts upwards")
        goal.set_accepted()
        threading.Thread(target=run, args=[goal], daemon=True).start()

    server = actionlib.ActionServer(action, classes["Action"], take, auto_start=False)
    server.start()
    say("ready")
    rospy.spin()


def send(action, package, order, cancel_after="0", how="goal"):
    classes, heard = fibonacci(package), []
    client = actionlib.SimpleActionClient(action, classes["Action"])
    cancel = {
        "goal": client.cancel_goal,
        "all": client.cancel_all_goals,
        "before": lambda: client.cancel_goals_at_and_before_time(rospy.Time.now()),
    }

    def feedback(message):
        heard.append(len(message.sequence))
        say("feedback", length=heard[-1])
        if len(heard) == int(cancel_after):
            cancel[how]()

    say("server", found=client.wait_for_server(rospy.Duration(30)))
    client.send_goal(classes["Goal"](order=int(order)), feedback_cb=feedback)
    finished = client.wait_for_result(rospy.Duration(60))
    length = len(getattr(client.get_result(), "sequence", []))
    say("result", finished=finished, state=client.get_state(), length=length, text=client.get_goal_status_text())


def crowd(node, topic, count):
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    master = rosgraph.Master(rospy.get_name())
    api = xmlrpc.client.ServerProxy(master.lookupNode(node))
    port = api.requestTopic(rospy.get_name(), topic, [["TCPROS"]])[2][2]
    connections = [socket.create_connection(("localhost", port)) for _ in range(int(count))]
    say("ready")
    while not rospy.is_shutdown():
        ended, _, _ = select.select(connections, [], [], 0.1)
        for connection in ended:
            connections.remove(connection)
            connection.close()
            connections.append(socket.create_connection(("localhost", port)))


def nodes():
    state = rosgraph.Master(rospy.get_name()).getSystemState()
    say("nodes", names=sorted({node for kind in state for _, names in kind for node in names}))


def call(service, values):
    values = [value == "true" for value in values.split(",")]
    rospy.wait_for_service(service, timeout=10)
    proxy = rospy.ServiceProxy(service, SetBool, persistent=len(values) > 1)
    for value in values:
        try:
            response = proxy(value)
            say("response", success=response.success, message=response.message)
        except rospy.ServiceException as error:
            say("error", text=str(error))


if __name__ == "__main__":
    name, mode, *arguments = sys.argv[1:]
    rospy.init_node(name, disable_rosout=True)
    globals()[mode.replace("-", "_")](*arguments)
