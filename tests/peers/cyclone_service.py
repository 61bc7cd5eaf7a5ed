"""A ROS 2 server or client of example_interfaces/srv/AddTwoInts as rmw_cyclonedds would make it. See README.md."""

import argparse
import json
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import int64, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

# rmw_cyclonedds puts a header before the body of requests and replies: the client's number, and a sequence number.


@dataclass
@final
class Request(IdlStruct, typename="example_interfaces::srv::dds_::AddTwoInts_Request_"):
    guid: uint64
    seq: int64
    a: int64
    b: int64


@dataclass
@final
class Response(IdlStruct, typename="example_interfaces::srv::dds_::AddTwoInts_Response_"):
    guid: uint64
    seq: int64
    sum: int64


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def endpoints(service, reads, writes):
    qos = Qos(
        Policy.Reliability.Reliable(duration(seconds=10)),
        Policy.Durability.Volatile,
        Policy.History.KeepLast(10),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
    names = {Request: f"rq{service}Request", Response: f"rr{service}Reply"}
    reader = DataReader(participant, Topic(participant, names[reads], reads, qos=qos), qos=qos)
    writer = DataWriter(participant, Topic(participant, names[writes], writes, qos=qos), qos=qos)
    say(event="ready")
    return reader, writer


def serve(service):
    reader, writer = endpoints(service, Request, Response)
    while True:
        for asked in reader.take(N=16):
            if isinstance(asked, Request):
                writer.write(Response(asked.guid, asked.seq, asked.a + asked.b))
        time.sleep(0.002)


def call(service, a, b):
    reader, writer = endpoints(service, Response, Request)
    while not (writer.get_matched_subscriptions() and reader.get_matched_publications()):
        time.sleep(0.01)
    # Both ends must have found each other, and only one end of that shows here.
    for attempt in range(100):
        writer.write(Request(0x1122334455667788, attempt, a, b))
        for _ in range(100):
            for reply in reader.take(N=16):
                if isinstance(reply, Response) and reply.guid == 0x1122334455667788 and reply.seq == attempt:
                    return say(event="reply", sum=reply.sum)
            time.sleep(0.002)


p = argparse.ArgumentParser()
p.add_argument("verb", choices=["serve", "call"])
p.add_argument("--service", default="/add_two_ints")
p.add_argument("--domain", type=int, default=0)
p.add_argument("--a", type=int, default=0)
p.add_argument("--b", type=int, default=0)
args = p.parse_args()
participant = DomainParticipant(args.domain)
serve(args.service) if args.verb == "serve" else call(args.service, args.a, args.b)
