#!/usr/bin/env python3
"""Makes texts.json and messages.json: how PyYAML prints texts, and how rclpy and rosidl_runtime_py encode and print messages.

Needs ROS 2 (Kilted) from PyPI: `pip install ros-rclpy ros-rmw-fastrtps-cpp ros-std-msgs ros-geometry-msgs ros-nav-msgs pyyaml==6.0.3`, and the source of
https://github.com/ros2/rosidl_runtime_py on PYTHONPATH, which is not on PyPI.
"""

import array
import json
import pathlib
import sys

import yaml
from geometry_msgs.msg import Point32, Polygon, PolygonStamped, PoseStamped, PoseWithCovariance
from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_runtime_py import message_to_yaml
from std_msgs.msg import (
    Bool, Byte, Char, Empty, Float32, Float64MultiArray, Header, Int64, MultiArrayDimension, String, UInt8MultiArray, UInt64,
)

HERE = pathlib.Path(__file__).parent


def save(name, value):
    (HERE / name).write_text(json.dumps(value, indent=1) + "\n")


texts = [
    '', 'hello', 'hello world', ' lead', 'trail ', 'on', 'yes', 'y', 'no', 'null', '~', 'Null', 'true', '1', '-1',
    '+1', '0x1F', '0b1', '017', '09', '1_000', '1:20', '1.5', '1.', '.5', '1e5', '1.0e+5', '1e+5', '.inf', '-.INF',
    '.nan', 'nan', '2026-11-22', '2026-1-2 3:04:05', '2026-11-22T10:00:00Z', '=', '<<', 'a: b', 'a:b', 'a:', ':a',
    ': a', 'a #b', 'a#b', '#a', '- a', '-a', '-', '?', '? a', '?a', 'a?', 'a, b', ',a', '[a', 'a]', '{}', '&a', '*a',
    '!a', '|', '>', "'", "it's", '"', 'a"b', '%a', '@a', '`a', '---', '--- a', '----', '...', '....', 'a\nb', 'a\n',
    '\na', 'a\n\nb', 'a\n b', 'a \nb', '\n', '\n\n', 'a\tb', '\t', 'a\rb', '\x00', '\x01x', '\x1b[0m', 'ü', 'é€',
    '\x85', 'a\u2028b', '\ufeff', '😀', '😀\t', '\xa0', 'a\xa0\tb', '\\', 'a\\b', 'a\\\t"b', 'map', 'base_link', 'a  b',
    "it's\nnew", '0', '00', '0o7', 'x' * 100 + ' ' + 'y' * 100,
]
texts = [[text, yaml.dump({"a": text}, allow_unicode=True, width=sys.maxsize)[3:-1]] for text in texts]
save("texts.json", texts)

cases = []


def add(message):
    kind = type(message)
    # What a subscriber gets: of a float32, the double that it is.
    message = deserialize_message(serialize_message(message), kind)
    cases.append(
        {
            "type": f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}",
            "cdr": serialize_message(message).hex(),
            "yaml": message_to_yaml(message, truncate_length=128),
            "no_arr": message_to_yaml(message, truncate_length=128, no_arr=True),
            "no_str": message_to_yaml(message, truncate_length=3, no_str=True),
            "repr": repr(message),
        }
    )


for text in ["hello", "a: b\nc", "", "x" * 200]:
    add(String(data=text))
for number in [0.1, float("nan"), 1e20]:
    add(Float32(data=number))
for message in [
    Empty(), Byte(data=b"\x02"), Byte(data=b"A"), Bool(data=True), Char(data=65), Int64(data=-(2**63)), UInt64(data=2**64 - 1),
]:
    add(message)
header = Header(frame_id="map")
header.stamp.sec, header.stamp.nanosec = 1700000000, 5
add(header)
pose = PoseStamped(header=header)
pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.w = 1.5, -2e-7, 1e16
add(pose)
add(PoseWithCovariance())
add(PolygonStamped(header=header, polygon=Polygon(points=[Point32(x=float(i), y=0.1) for i in range(3)])))
add(PolygonStamped())
octets = UInt8MultiArray(data=array.array("B", [i % 256 for i in range(300)]))
octets.layout.dim = [MultiArrayDimension(label="on", size=300, stride=1)]
add(octets)
add(Float64MultiArray(data=[0.1, 1.0, float("inf")]))
grid = OccupancyGrid(header=header, data=array.array("b", [-1, 0, 100]))
grid.info.width = 3
add(grid)
save("messages.json", cases)
