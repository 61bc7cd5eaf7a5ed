"""A ROS 2 talker or listener of std_msgs/msg/String, as in rmw_cyclonedds. See README.md."""

import argparse
import json
import os
import struct
import sys
import time
import zlib
from dataclasses import dataclass


def arguments():
    p = argparse.ArgumentParser()
    p.add_argument("verb", choices=["talk", "listen"])
    p.add_argument("--topic", default="rt/chatter")
    p.add_argument("--domain", type=int, default=0)
    p.add_argument("--best-effort", action="store_true")
    p.add_argument("--transient-local", action="store_true")
    p.add_argument("--depth", type=int, default=10)
    p.add_argument("--lease", type=int, help="ask for liveliness and a message in so many milliseconds, and say what comes of it")
    p.add_argument("--no-deadline", action="store_true", help="with --lease: ask for liveliness alone")
    p.add_argument("--peer", help="discover this address by unicast, nothing by multicast")
    p.add_argument("--count", type=int, default=0, help="0: until killed")
    p.add_argument("--rate", type=float, default=10)
    p.add_argument("--size", type=int, default=64)
    p.add_argument("--text", default="hello from the robot")
    p.add_argument("--gate", help="send warm-up messages, numbered -1, until this file exists")
    p.add_argument("--more-topics", type=int, default=0, help="as many writers of other topics, which write nothing")
    p.add_argument("--node", help="announce a ROS node of this name, as rmw_cyclonedds does")
    p.add_argument("--keyed", action="store_true", help="a type whose only field is its key")
    p.add_argument("--no-wait", action="store_true", help="talk without a listener")
    return p.parse_args()


args = arguments()
if args.peer:
    # Cyclone reads its configuration from the environment when its library is loaded.
    os.environ["CYCLONEDDS_URI"] = (
        "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General><Discovery>"
        f'<ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="{args.peer}"/></Peers>'
        "</Discovery></Domain></CycloneDDS>"
    )

from cyclonedds._clayer import ddspy_take
from cyclonedds.core import Listener, Policy, Qos, ReadCondition, ViewState, InstanceState, SampleState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final, key
from cyclonedds.idl.types import array, sequence, uint8
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
@final
class String_(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str


@dataclass
@final
class Keyed_(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str
    key("data")


@dataclass
@final
class Gid_(IdlStruct, typename="rmw_dds_common::msg::dds_::Gid_"):
    data: array[uint8, 16]


@dataclass
@final
class NodeEntitiesInfo_(IdlStruct, typename="rmw_dds_common::msg::dds_::NodeEntitiesInfo_"):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[Gid_]
    writer_gid_seq: sequence[Gid_]


@dataclass
@final
class ParticipantEntitiesInfo_(IdlStruct, typename="rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"):
    gid: Gid_
    node_entities_info_seq: sequence[NodeEntitiesInfo_]


def announce(participant, readers=(), writers=()):
    """Announces the endpoints of a ROS node.

    The announcement lasts as long as the returned writer exists.
    """
    if not args.node:
        return None
    latched = Qos(
        Policy.Reliability.Reliable(duration(seconds=10)),
        Policy.Durability.TransientLocal,
        Policy.History.KeepLast(1),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
    gid = lambda entity: Gid_(list(entity.guid.bytes))
    topic = Topic(participant, "ros_discovery_info", ParticipantEntitiesInfo_, qos=latched)
    writer = DataWriter(participant, topic, qos=latched)
    node = NodeEntitiesInfo_("/", args.node, [gid(reader) for reader in readers], [gid(writer) for writer in writers])
    writer.write(ParticipantEntitiesInfo_(gid(participant), [node]))
    return writer


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def qos():
    reliable = Policy.Reliability.Reliable(duration(seconds=10))
    promises = []
    if args.lease:
        lease = duration(milliseconds=args.lease)
        promises = [Policy.Liveliness.Automatic(lease)]
        if not args.no_deadline:
            promises.append(Policy.Deadline(lease))
    return Qos(
        *promises,
        Policy.Reliability.BestEffort if args.best_effort else reliable,
        Policy.Durability.TransientLocal if args.transient_local else Policy.Durability.Volatile,
        Policy.History.KeepLast(args.depth),
        # What a latched writer keeps for late joiners; rmw_cyclonedds sets the same.
        Policy.DurabilityService(0, Policy.History.KeepLast(args.depth), -1, -1, -1),
        # ROS 2 uses XCDR1 only.
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


def talk(participant):
    kind = Keyed_ if args.keyed else String_
    writer = DataWriter(participant, Topic(participant, args.topic, kind, qos=qos()), qos=qos())
    node = announce(participant, writers=[writer])
    topics = [Topic(participant, f"{args.topic}{n}", String_, qos=qos()) for n in range(args.more_topics)]
    more = [DataWriter(participant, topic, qos=qos()) for topic in topics]
    say(event="ready")
    while not args.no_wait and not writer.get_matched_subscriptions():
        time.sleep(0.01)
    say(event="matched")
    # Sequence number, clock and CRC take 42 bytes: 10 + 20 + 10 digits, padded with zeros, and
    # spaces between.
    room = max(0, args.size - 43)
    filler = (args.text + " ") * (room // (len(args.text) + 1) + 1)
    filler = filler[:room]
    crc = zlib.crc32(filler.encode())

    def write(sequence):
        writer.write(kind(f"{sequence:010d} {time.monotonic_ns():020d} {crc:010d} {filler}"))

    while args.gate and not os.path.exists(args.gate):
        write(-1)
        time.sleep(1 / args.rate)
    start = time.monotonic()
    sequence = 0
    while args.count == 0 or sequence < args.count:
        wait = start + sequence / args.rate - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        write(sequence)
        sequence += 1
    say(event="done", sent=sequence)
    while True:
        time.sleep(3600)


class Promises(Listener):
    lost = 0

    def on_liveliness_changed(self, reader, status):
        self.lost += max(0, status.not_alive_count_change)
        say(event="liveliness", alive=status.alive_count, lost=self.lost)

    def on_requested_deadline_missed(self, reader, status):
        say(event="deadline missed")


def listen(participant):
    listener = Promises() if args.lease else None
    reader = DataReader(participant, Topic(participant, args.topic, String_, qos=qos()), qos=qos(), listener=listener)
    node = announce(participant, readers=[reader])
    condition = ReadCondition(reader, ViewState.Any | InstanceState.Any | SampleState.NotRead)
    waitset = WaitSet(participant)
    waitset.attach(condition)
    say(event="ready")
    matched = False
    while True:
        waitset.wait(duration(milliseconds=100))
        if not matched and reader.get_matched_publications():
            matched = True
            say(event="matched")
        for body, info in ddspy_take(reader._ref, SampleState.Any | ViewState.Any | InstanceState.Any, 64):
            now = time.monotonic_ns()
            if info.valid_data:
                report(memoryview(body), now)


def report(body, now):
    """Reports a message.

    Decodes the CDR string itself, because the binding would copy a large string several times.
    """
    try:
        (length,) = struct.unpack_from("<I", body, 4)
        data = body[8 : 8 + length - 1]
        sequence, clock, crc = bytes(data[:42]).split(b" ")
        filler = data[43:]
        intact = zlib.crc32(filler) == int(crc)
        say(event="message", seq=int(sequence), latency_ns=now - int(clock), bytes=len(data), intact=intact, text=str(filler[:40], "utf-8"))
    except ValueError:
        say(event="message", seq=-1, latency_ns=0, bytes=len(data), intact=False, text="")


participant = DomainParticipant(args.domain)
talk(participant) if args.verb == "talk" else listen(participant)
