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


texts = ['', 'hello', 'hello world', ' lead', 'trail ', 'on', 'yes', 'y', 'no', 'null', '~', 'Null', 'true', '1', '-1', '+1', '0x1F', '0b1', '017', '09', '1_000', '1:20', '1.5', '1.', '.5', '1e5', '1.0e+5', '1e+5', '.inf', '-.INF', '.nan', 'nan', '2026-11-22', '2026-1-2 3:04:05', '2026-11-22T10:00:00Z', '=', '<<', 'a: b', 'a:b', 'a:', ':a', ': a', 'a #b', 'a#b', '#a', '- a', '-a', '-', '?', '? a', '?a', 'a?', 'a, b', ',a', '[a', 'a]', '{}', '&a', '*a', '!a', '|', '>', "'", "it's", '"', 'a"b', '%a', '@a', '`a', '---', '--- a', '----', '...', '....', 'a\nb', 'a\n', '\na', 'a\n\nb', 'a\n b', 'a \nb', '\n', '\n\n', 'a\tb', '\t', 'a\rb', '\x00', '\x01x', '\x1b[0m', 'ü', 'é€', '\u0085', 'a\u2028b', '\ufeff', '😀', '😀\t', '\u00a0', 'a\u00a0\tb', '\\', 'a\\b', 'a\\\t"b', 'map', 'base_link', 'a  b', 'it\'s\nnew', '0', '00', '0o7', 'x'*100 + ' ' + 'y'*100]
texts = [[text, yaml.dump({"a": text}, allow_unicode=True, width=sys.maxsize)[3:-1]] for text in texts]
save("texts.json", texts)

cases = []
def add(m):
    t = type(m)
    m = deserialize_message(serialize_message(m), t)
    name = t.__module__.split('.')[0] + '/msg/' + t.__name__
    cases.append({'type': name, 'cdr': serialize_message(m).hex(), 'yaml': message_to_yaml(m, truncate_length=128),
      'no_arr': message_to_yaml(m, truncate_length=128, no_arr=True), 'no_str': message_to_yaml(m, truncate_length=3, no_str=True), 'repr': repr(m)})
add(String(data='hello')); add(String(data='a: b\nc')); add(String()); add(String(data='x'*200)); add(Empty()); add(Byte(data=b'\x02')); add(Byte(data=b'A'))
add(Float32(data=0.1)); add(Float32(data=float('nan'))); add(Float32(data=1e20)); add(Int64(data=-2**63)); add(UInt64(data=2**64-1)); add(Bool(data=True)); add(Char(data=65))
h = Header(frame_id='map'); h.stamp.sec = 1700000000; h.stamp.nanosec = 5
add(h)
p = PoseStamped(header=h); p.pose.position.x = 1.5; p.pose.position.y = -2e-7; p.pose.orientation.w = 1e16
add(p); add(PoseWithCovariance())
add(PolygonStamped(header=h, polygon=Polygon(points=[Point32(x=float(i), y=0.1) for i in range(3)])))
add(PolygonStamped())
u = UInt8MultiArray(); u.data = array.array('B', [i % 256 for i in range(300)]); u.layout.dim = [MultiArrayDimension(label='on', size=300, stride=1)]
add(u)
d = Float64MultiArray(); d.data = [0.1, 1.0, float('inf')]
add(d)
g = OccupancyGrid(header=h); g.data = array.array('b', [-1, 0, 100]); g.info.width = 3
add(g)
save("messages.json", cases)
