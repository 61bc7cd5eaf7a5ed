"""A talker or listener of std_msgs/msg/String on dust_dds. See README.md."""

import argparse
import json
import os
import sys
import time
import zlib
from dataclasses import dataclass

import dust_dds as dds


@dataclass
class String_:
    data: str


# dust_dds takes the type's name in DDS from the class.
String_.__name__ = "std_msgs::msg::dds_::String_"


def arguments():
    p = argparse.ArgumentParser()
    p.add_argument("verb", choices=["talk", "listen"])
    p.add_argument("--topic", default="rt/chatter")
    p.add_argument("--domain", type=int, default=0)
    p.add_argument("--best-effort", action="store_true")
    p.add_argument("--transient-local", action="store_true")
    p.add_argument("--depth", type=int, default=10)
    p.add_argument("--lease", type=int, help="liveliness lease of the talker in milliseconds; dust_dds reports none to a listener")
    p.add_argument("--count", type=int, default=0, help="0: until killed")
    p.add_argument("--rate", type=float, default=10)
    p.add_argument("--size", type=int, default=64)
    p.add_argument("--text", default="hello from the robot")
    p.add_argument("--gate", help="send warm-up messages, numbered -1, until this file exists")
    p.add_argument("--no-wait", action="store_true", help="talk without a listener")
    return p.parse_args()


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def finite(milliseconds):
    return dds.DurationKind.Finite(dds.Duration(milliseconds // 1000, milliseconds % 1000 * 1_000_000))


def qos(args):
    reliability, durability = dds.ReliabilityQosPolicyKind, dds.DurabilityQosPolicyKind
    policies = {
        "reliability": dds.ReliabilityQosPolicy(
            reliability.BestEffort if args.best_effort else reliability.Reliable, finite(10_000)
        ),
        "durability": dds.DurabilityQosPolicy(durability.TransientLocal if args.transient_local else durability.Volatile),
        "history": dds.HistoryQosPolicy(dds.HistoryQosPolicyKind.KeepLast(args.depth)),
    }
    if args.lease:
        policies["liveliness"] = dds.LivelinessQosPolicy(dds.LivelinessQosPolicyKind.Automatic, finite(args.lease))
    return policies


def talk(participant, topic, args):
    writer = participant.create_publisher().create_datawriter(topic, dds.DataWriterQos(**qos(args)))
    say(event="ready")
    while not args.no_wait and not writer.get_matched_subscriptions():
        time.sleep(0.01)
    say(event="matched")
    room = max(0, args.size - 43)
    filler = ((args.text + " ") * (room // (len(args.text) + 1) + 1))[:room]
    crc = zlib.crc32(filler.encode())

    def write(sequence):
        writer.write(String_(data=f"{sequence:010d} {time.monotonic_ns():020d} {crc:010d} {filler}"))
        time.sleep(1 / args.rate)

    while args.gate and not os.path.exists(args.gate):
        write(-1)
    sequence = 0
    while args.count == 0 or sequence < args.count:
        write(sequence)
        sequence += 1
    say(event="done", sent=sequence)
    while True:
        time.sleep(3600)


def listen(participant, topic, args):
    reader = participant.create_subscriber().create_datareader(topic, dds.DataReaderQos(**qos(args)))
    say(event="ready")
    matched = False
    while True:
        if not matched and reader.get_matched_publications():
            matched = True
            say(event="matched")
        for sample in samples(reader):
            now = time.monotonic_ns()
            text = sample.data
            sequence, clock, crc, filler = text.split(" ", 3)
            intact = zlib.crc32(filler.encode()) == int(crc)
            say(event="message", seq=int(sequence), latency_ns=now - int(clock), bytes=len(text), intact=intact, text=filler[:40])
        time.sleep(0.002)


def samples(reader):
    """Takes what has arrived. dust_dds raises an exception if there is nothing."""
    try:
        taken = reader.take(max_samples=64)
    except Exception as error:
        if "NoData" in str(error):
            return []
        raise
    return [sample.get_data() for sample in taken if sample.get_sample_info().get_valid_data()]


args = arguments()
participant = dds.DomainParticipantFactory.get_instance().create_participant(domain_id=args.domain)
topic = participant.create_topic(topic_name=args.topic, type_=String_)
{"talk": talk, "listen": listen}[args.verb](participant, topic, args)
