#!/usr/bin/env python3
"""A rospy node that publishes or receives every type of the pairings. See ../README.md.

rospy_any.py talk FOLDER PREFIX
rospy_any.py listen FOLDER PREFIX...
"""

import io
import json
import sys
from pathlib import Path

import genpy.dynamic
import roslib.message
import rospy


def say(**what):
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def class_of(entry):
    """Returns the class of an installed package, otherwise one generated from the definition.

    Tools that lack the package also generate it.
    """
    installed = roslib.message.get_message_class(entry["ros1"])
    return installed or genpy.dynamic.generate_dynamic(entry["ros1"], entry["definition"])[entry["ros1"]]


def without_seq(value):
    """Clears the sequence number in all headers, because each publisher counts its own."""
    if isinstance(value, (list, tuple)):
        if value and hasattr(value[0], "__slots__"):
            [without_seq(item) for item in value]
    elif hasattr(value, "_type"):
        if value._type == "std_msgs/Header":
            value.seq = 0
        [without_seq(getattr(value, name)) for name in value.__slots__]


def same(message, sample):
    without_seq(message)
    written = io.BytesIO()
    message.serialize(written)
    return written.getvalue() == sample


def main():
    verb, folder, *prefixes = sys.argv[1:]
    folder = Path(folder)
    index = json.loads((folder / "index.json").read_text())
    samples = {key: (folder / f"{key}.ros1").read_bytes() for key in index}
    classes = {key: class_of(entry) for key, entry in index.items()}
    rospy.init_node(f"any_{verb}", disable_rosout=True)
    if verb == "listen":
        for prefix in prefixes:
            for key in index:
                topic = f"{prefix}/{key}"
                heard = lambda message, key=key, topic=topic: say(event="message", topic=topic, same=same(message, samples[key]))
                rospy.Subscriber(topic, classes[key], heard, buff_size=4 << 20)
        say(event="ready")
        rospy.spin()
        return
    publishers = {key: rospy.Publisher(f"{prefixes[0]}/{key}", classes[key], queue_size=5) for key in index}
    messages = {key: classes[key]().deserialize(sample) for key, sample in samples.items()}
    say(event="ready")
    rate = rospy.Rate(2)
    while not rospy.is_shutdown():
        [publishers[key].publish(message) for key, message in messages.items()]
        rate.sleep()


main()
