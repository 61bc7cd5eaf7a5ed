"""Runs Cyclone DDS nodes that repeatedly leave and return. See ../README.md.

The topics are /churn/t0, /churn/t1, ..., of std_msgs/msg/String.

churn.py talk|listen TOPICS GATE [EACH [SEED]]

Each node has EACH of the topics, ten by default. Several times a second a node leaves, and returns within two
seconds. Once the file GATE exists, all nodes return and stay. A listener prints every second the
number of topics that it received in the last three seconds, and the total number of nodes created.
"""

import json
import os
import random
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PERIOD = 0.3


@dataclass
@final
class String_(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


verb, topics, gate = sys.argv[1], int(sys.argv[2]), sys.argv[3]
NODE, seed = (int(number) for number in (sys.argv[4:6] + ["10", "0"][len(sys.argv[4:6]) :]))
if seed:
    random.seed(seed)
qos = Qos(
    Policy.Reliability.Reliable(duration(seconds=1)),
    Policy.History.KeepLast(10),
    Policy.DataRepresentation(use_cdrv0_representation=True),
)


def node(first):
    participant = DomainParticipant(0)
    ends = {}
    for number in range(first, min(first + NODE, topics)):
        topic = Topic(participant, f"rt/churn/t{number}", String_, qos=qos)
        ends[number] = DataWriter(participant, topic, qos=qos) if verb == "talk" else DataReader(participant, topic, qos=qos)
    return participant, ends


nodes = {first: node(first) for first in range(0, topics, NODE)}
away, came, heard, sent, said, changed, settled = {}, len(nodes), {}, 0, 0.0, 0.0, False
print(json.dumps({"event": "ready"}), flush=True)
while True:
    now = time.monotonic()
    opened = os.path.exists(gate)
    for first in [first for first, due in away.items() if opened or now >= due]:
        nodes[first] = node(first)
        del away[first]
        came += 1
    if opened and not settled:
        # Events from before this point do not count.
        settled = True
        heard.clear()
    if not opened and now - changed >= PERIOD and nodes:
        changed = now
        first = random.choice(list(nodes))
        # Deleted in order, with goodbye messages, as by a node that shuts down.
        del nodes[first]
        away[first] = now + random.uniform(0, 2)
    for _, ends in nodes.values():
        for number, end in ends.items():
            if verb == "talk":
                end.write(String_(f"{number} {sent}"))
            elif end.take(N=32):
                heard[number] = now
    sent += 1
    if verb == "listen" and now - said >= 1:
        said = now
        recent = sum(1 for at in heard.values() if now - at < 3)
        missing = [number for number in range(topics) if now - heard.get(number, 0) >= 3] if settled else []
        line = {"event": "heard", "topics": recent, "nodes": came, "settled": settled, "missing": missing}
        print(json.dumps(line), flush=True)
    time.sleep(0.5 if verb == "talk" else 0.2)
