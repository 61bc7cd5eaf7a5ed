"""Writes one message of each type that the pairings exchange. See ../README.md.

rosbags encodes the messages in CDR and in ROS 1 serialization.

samples.py FOLDER
"""

import json
import sys
from pathlib import Path

import numpy
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

# A type of a package that is in no distribution.
REPORT = """\
uint8 IDLE=0
uint8 MOVING=1
std_msgs/Header header
uint8 state
arm_msgs/Joint[] joints
geometry_msgs/Pose[2] ends
bool[3] limits
uint8[] blob
string[] notes
"""
JOINT = """\
string name
float64[3] axis
float32[] efforts
{duration} settled
{time} since
int64 ticks
"""
ROS1 = {"Report": REPORT, "Joint": JOINT.format(duration="duration", time="time")}
ROS2 = {"Report": REPORT, "Joint": JOINT.format(duration="builtin_interfaces/Duration", time="builtin_interfaces/Time")}


def registered(kind, texts):
    store = get_typestore(kind)
    types = {}
    for name, text in texts.items():
        types.update(get_types_from_msg(text, f"arm_msgs/msg/{name}"))
    store.register(types)
    return store


store = registered(Stores.ROS2_HUMBLE, ROS2)
folder = Path(sys.argv[1])


def make(kind, **fields):
    return store.types[kind](**fields)


def header(frame):
    stamp = make("builtin_interfaces/msg/Time", sec=1_700_000_000, nanosec=123_456_789)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def noise(count):
    return numpy.random.default_rng(count).integers(0, 256, count, dtype=numpy.uint8)


def vector(x, y, z):
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def rotation():
    return make("geometry_msgs/msg/Quaternion", x=0.0, y=0.6, z=0.0, w=0.8)


def transform(child):
    moved = make("geometry_msgs/msg/Transform", translation=vector(1.0, -2.5, 0.25), rotation=rotation())
    return make("geometry_msgs/msg/TransformStamped", header=header("map"), child_frame_id=child, transform=moved)


def pose(x):
    return make("geometry_msgs/msg/Pose", position=make("geometry_msgs/msg/Point", x=x, y=0.5, z=-1.0), orientation=rotation())


def joint(name, efforts):
    since = make("builtin_interfaces/msg/Time", sec=7, nanosec=8)
    settled = make("builtin_interfaces/msg/Duration", sec=-1, nanosec=500_000_000)
    axis, efforts = numpy.array([0.0, 1.0, 0.0]), numpy.array(efforts, dtype=numpy.float32)
    return make("arm_msgs/msg/Joint", name=name, axis=axis, efforts=efforts, settled=settled, since=since, ticks=-(2**40))


def field(name, offset):
    return make("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=7, count=1)


SAMPLES = {
    "string": make("std_msgs/msg/String", data="Grüße, 日本語"),
    "image": make(
        "sensor_msgs/msg/Image", header=header("camera"), height=512, width=683, encoding="bgr8", is_bigendian=0, step=2049,
        data=noise(512 * 2049),
    ),
    "cloud": make(
        "sensor_msgs/msg/PointCloud2", header=header("lidar"), height=1, width=5000,
        fields=[field("x", 0), field("y", 4), field("z", 8)], is_bigendian=False, point_step=12, row_step=60000,
        data=noise(60000), is_dense=True,
    ),
    "joints": make(
        "sensor_msgs/msg/JointState", header=header(""), name=["shoulder", "elbow", "wrist"],
        position=numpy.array([0.1, -1.5, 3.0]), velocity=numpy.array([]), effort=numpy.array([1e-9, 2.0, float("inf")]),
    ),
    "tf": make("tf2_msgs/msg/TFMessage", transforms=[transform("base"), transform("arm/tool")]),
    "report": make(
        "arm_msgs/msg/Report", header=header("arm"), state=1, joints=[joint("a", [1.5]), joint("bc", []), joint("", [0.25, 2.0, 8.0])],
        ends=[pose(1.0), pose(2.0)], limits=numpy.array([True, False, True]), blob=noise(7), notes=["", "two"],
    ),
}

index = {}
for key, message in SAMPLES.items():
    kind = message.__msgtype__
    cdr = bytes(store.serialize_cdr(message, kind))
    (folder / f"{key}.cdr").write_bytes(cdr)
    (folder / f"{key}.ros1").write_bytes(bytes(store.cdr_to_ros1(cdr, kind)))
    index[key] = {"type": kind, "ros1": kind.replace("/msg/", "/")}
index["report"]["definition"] = registered(Stores.ROS1_NOETIC, ROS1).generate_msgdef("arm_msgs/msg/Report", ros_version=1)[0]
(folder / "index.json").write_text(json.dumps(index))

# The layout of a ROS 2 installation.
share = folder / "share" / "arm_msgs" / "msg"
share.mkdir(parents=True)
for name, text in ROS2.items():
    (share / f"{name}.msg").write_text(text)
