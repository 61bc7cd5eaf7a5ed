"""A ROS 2 node that publishes or receives every type of the pairings. See ../README.md.

The node is as rmw_cyclonedds would create it.

cyclone_any.py talk FOLDER PREFIX
cyclone_any.py listen FOLDER PREFIX...
"""

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from cyclonedds._clayer import ddspy_take
from cyclonedds.core import InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, float32, float64, int32, int64, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


def ros(package, name):
    """Returns the DDS type name that ROS 2's code generators use."""
    return {"typename": f"{package}::msg::dds_::{name}_"}


@dataclass
@final
class Time(IdlStruct, **ros("builtin_interfaces", "Time")):
    sec: int32
    nanosec: uint32


@dataclass
@final
class Duration(IdlStruct, **ros("builtin_interfaces", "Duration")):
    sec: int32
    nanosec: uint32


@dataclass
@final
class Header(IdlStruct, **ros("std_msgs", "Header")):
    stamp: Time
    frame_id: str


@dataclass
@final
class String(IdlStruct, **ros("std_msgs", "String")):
    data: str


@dataclass
@final
class Image(IdlStruct, **ros("sensor_msgs", "Image")):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
@final
class PointField(IdlStruct, **ros("sensor_msgs", "PointField")):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@dataclass
@final
class PointCloud2(IdlStruct, **ros("sensor_msgs", "PointCloud2")):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


@dataclass
@final
class JointState(IdlStruct, **ros("sensor_msgs", "JointState")):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
@final
class Vector3(IdlStruct, **ros("geometry_msgs", "Vector3")):
    x: float64
    y: float64
    z: float64


@dataclass
@final
class Point(IdlStruct, **ros("geometry_msgs", "Point")):
    x: float64
    y: float64
    z: float64


@dataclass
@final
class Quaternion(IdlStruct, **ros("geometry_msgs", "Quaternion")):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
@final
class Transform(IdlStruct, **ros("geometry_msgs", "Transform")):
    translation: Vector3
    rotation: Quaternion


@dataclass
@final
class TransformStamped(IdlStruct, **ros("geometry_msgs", "TransformStamped")):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
@final
class TFMessage(IdlStruct, **ros("tf2_msgs", "TFMessage")):
    transforms: sequence[TransformStamped]


@dataclass
@final
class Pose(IdlStruct, **ros("geometry_msgs", "Pose")):
    position: Point
    orientation: Quaternion


@dataclass
@final
class Joint(IdlStruct, **ros("arm_msgs", "Joint")):
    name: str
    axis: array[float64, 3]
    efforts: sequence[float32]
    settled: Duration
    since: Time
    ticks: int64


@dataclass
@final
class Report(IdlStruct, **ros("arm_msgs", "Report")):
    header: Header
    state: uint8
    joints: sequence[Joint]
    ends: array[Pose, 2]
    limits: array[bool, 3]
    blob: sequence[uint8]
    notes: sequence[str]


def say(**what):
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def same(body, sample):
    """Compares the data after the encapsulation header.

    A middleware may pad the last word with zeros.
    """
    body, sample = bytes(body[4:]), sample[4:]
    rest = body[len(sample) :]
    return body[: len(sample)] == sample and len(rest) < 4 and not any(rest)


verb, folder, *prefixes = sys.argv[1:]
folder = Path(folder)
index = json.loads((folder / "index.json").read_text())
samples = {key: (folder / f"{key}.cdr").read_bytes() for key in index}
classes = {key: globals()[entry["type"].rsplit("/", 1)[1]] for key, entry in index.items()}
qos = Qos(
    Policy.Reliability.Reliable(duration(seconds=10)),
    Policy.History.KeepLast(10),
    # ROS 2 uses XCDR1 only.
    Policy.DataRepresentation(use_cdrv0_representation=True),
)
participant = DomainParticipant(0)


def topic(name, key):
    return Topic(participant, f"rt{name}", classes[key], qos=qos)


if verb == "talk":
    writers = {key: DataWriter(participant, topic(f"{prefixes[0]}/{key}", key), qos=qos) for key in index}
    messages = {key: classes[key].deserialize(sample) for key, sample in samples.items()}
    say(event="ready")
    while True:
        [writers[key].write(message) for key, message in messages.items()]
        time.sleep(0.5)

waitset, readers = WaitSet(participant), {}
for prefix in prefixes:
    for key in index:
        name = f"{prefix}/{key}"
        readers[name] = key, DataReader(participant, topic(name, key), qos=qos)
        waitset.attach(ReadCondition(readers[name][1], ViewState.Any | InstanceState.Any | SampleState.NotRead))
say(event="ready")
while True:
    waitset.wait(duration(milliseconds=100))
    for name, (key, reader) in readers.items():
        for body, info in ddspy_take(reader._ref, SampleState.Any | ViewState.Any | InstanceState.Any, 16):
            if info.valid_data:
                say(event="message", topic=name, same=same(body, samples[key]))
