"""A node of rclpy: `talk TOPIC` publishes texts, and `listen TOPIC` prints them."""

import sys

import rclpy
from std_msgs.msg import String

verb, topic = sys.argv[1:]
rclpy.init()
node = rclpy.create_node("ros_" + verb)
if verb == "talk":
    publisher = node.create_publisher(String, topic, 10)
    node.create_timer(0.2, lambda: publisher.publish(String(data="hello from ROS")))
else:
    node.create_subscription(String, topic, lambda message: print(message.data, flush=True), 10)
rclpy.spin(node)
