#!/usr/bin/env python3
"""What the Python package rosbags says of every message type it knows of Noetic, Humble and Jazzy: definition, hash, and messages of
random content in every encoding. One JSON object a line; `oracle.rs` compares. Same seed, same output.

    oracle.py SEED MESSAGES_PER_TYPE
"""

import base64
import json
import math
import random
import re
import sys

import numpy
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore, store as typestore
from rosbags.typesys.base import normalize_fieldname

STORES = {"noetic": Stores.ROS1_NOETIC, "humble": Stores.ROS2_HUMBLE, "jazzy": Stores.ROS2_JAZZY}
PLACEHOLDER = "structure_needs_at_least_one_member"
# rosidl makes an IDL uint8 of `char`, and hashes that; rosbags 0.11.9 does not know. `rosidl_hashes.txt` has what rosidl itself says.
typestore.TIDMAP["char"] = typestore.TIDMAP["uint8"]
STAMPS = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
TEXTS = ["", "map", "base_link", 'a "quoted" \\ text', "tab\tline\nend\r", "Grüße", "日本語", "🤖 robot", "\x01\x1f\x7f", "nul\0nul", "</script>"]


class Content:
    """Random values, each as rosbags wants it and as JSON."""

    def __init__(self, store, ros1, rng):
        self.store, self.ros1, self.rng = store, ros1, rng

    def message(self, name):
        values, members = {}, {}
        if name in STAMPS:
            seconds, nanoseconds = self.rng.randrange(2**31), self.rng.randrange(10**9)
            members = dict(zip(("secs", "nsecs") if self.ros1 else ("sec", "nanosec"), (seconds, nanoseconds)))
            return self.store.types[name](seconds, nanoseconds), members
        for field, desc in self.store.fielddefs[name][1]:
            if field == PLACEHOLDER:
                continue
            values[normalize_fieldname(field)], members[field] = self.field(desc)
        if self.rng.random() < 0.5:
            members = dict(self.rng.sample(list(members.items()), len(members)))
        return self.store.types[name](**values), members

    def field(self, desc):
        if desc[0] == Nodetype.NAME:
            return self.message(desc[1])
        if desc[0] == Nodetype.BASE:
            return self.base(*desc[1])
        inner, length = desc[1]
        if desc[0] == Nodetype.SEQUENCE:
            length = self.rng.choice([0, 1, 2, 3, 7, 40]) if length == 0 else self.rng.randrange(length + 1)
            length = min(length, 3) if inner[0] == Nodetype.NAME else length
        pairs = [self.field(inner) for _ in range(length)]
        values, members = [value for value, _ in pairs], [member for _, member in pairs]
        if inner[0] == Nodetype.NAME or inner[1][0] == "string":
            return values, members
        kind = inner[1][0]
        array = numpy.array(values, dtype={"bool": "bool_", "byte": "int8", "char": "uint8"}.get(kind, kind))
        if kind in ("byte", "char", "uint8"):
            members = base64.b64encode(array.tobytes()).decode()
        return array, members

    def base(self, kind, bound):
        rng = self.rng
        if kind == "string":
            text = rng.choice(TEXTS) + rng.choice(TEXTS) * rng.randrange(3)
            return text, text
        if kind == "bool":
            value = rng.random() < 0.5
            return value, value
        if kind.startswith("float"):
            return self.float(kind)
        if kind == "byte":
            value = rng.randrange(-128, 128)
            return value, value if self.ros1 else value & 0xFF
        bits = 8 if kind == "char" else int(kind.lstrip("uint"))
        signed = kind.startswith("int")
        low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1)) if signed else (0, 2**bits)
        value = rng.choice([0, 1, low, high - 1, rng.randrange(low, high)])
        return value, value if abs(value) <= 2**53 else str(value)

    def float(self, kind):
        value = self.rng.choice([0.0, -0.0, 1.0, -1.5, 0.1, 1e-7, 1e21, math.inf, -math.inf, math.nan, self.rng.gauss(0, 1e3)])
        if kind == "float64" and self.rng.random() < 0.2:
            value = self.rng.choice([5e-324, 1.7976931348623157e308, 1e300 * self.rng.random()])
        if kind == "float32":
            value = float(numpy.float32(value))
        if not math.isfinite(value):
            return value, "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
        return value, float(str(numpy.float32(value))) if kind == "float32" else value


def with_seq(name, text):
    """A ROS 2 definition that rosbags wrote in the ROS 1 dialect, with the `seq` that its conversions know of, and without bounds."""
    sections = re.split(r"(?m)^(=+\nMSG: \S+\n)", text)
    for index in range(0, len(sections), 2):
        of = name if index == 0 else sections[index - 1].split()[-1]
        if of in ("std_msgs/msg/Header", "std_msgs/Header"):
            sections[index] = "uint32 seq\n" + sections[index]
    return re.sub(r"<=\d+", "", "".join(sections))


def main():
    seed, count = int(sys.argv[1]), int(sys.argv[2])
    for distribution, which in STORES.items():
        store = get_typestore(which)
        ros1 = distribution == "noetic"
        # What ROS 1 has built in, rosbags has as messages of ROS 2.
        for name in sorted(store.fielddefs.keys() - (STAMPS if ros1 else ())):
            rng = random.Random(f"{seed} {distribution} {name}")
            text, md5 = store.generate_msgdef(name, ros_version=1 if ros1 else 2)
            case = {"distribution": distribution, "name": name, "text": text}
            case["hash"] = md5 if ros1 else store.hash_rihs01(name)
            if not ros1:
                case["ros1_text"] = with_seq(name, store.generate_msgdef(name, ros_version=1)[0])
            case["messages"] = []
            for _ in range(count):
                value, members = Content(store, ros1, rng).message(name)
                cdr = store.serialize_cdr(value, name, little_endian=True)
                message = {
                    "cdr": cdr.hex(),
                    "cdr_big_endian": store.serialize_cdr(value, name, little_endian=False).hex(),
                    "ros1": store.serialize_ros1(value, name).hex(),
                    "json": json.dumps(members),
                }
                if not ros1:
                    bridged = store.cdr_to_ros1(cdr, name)
                    message["bridged"] = bridged.hex()
                    assert store.ros1_to_cdr(bridged, name) == cdr, name
                case["messages"].append(message)
            print(json.dumps(case))
    print(json.dumps({"done": True}))


if __name__ == "__main__":
    main()
