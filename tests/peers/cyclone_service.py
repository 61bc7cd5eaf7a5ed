"""A ROS 2 server or client, as rmw_cyclonedds would create it. See README.md.

The services are example_interfaces/srv/AddTwoInts and std_srvs/srv/SetBool.
"""

import argparse
import json
import signal
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

# rmw_cyclonedds puts a header before the body of requests and replies: the client's number and a
# sequence number.
CLIENT = 0x1122334455667788


@dataclass
@final
class AddRequest(IdlStruct, typename="example_interfaces::srv::dds_::AddTwoInts_Request_"):
    guid: uint64
    seq: int64
    a: int64
    b: int64


@dataclass
@final
class AddResponse(IdlStruct, typename="example_interfaces::srv::dds_::AddTwoInts_Response_"):
    guid: uint64
    seq: int64
    sum: int64


@dataclass
@final
class SetRequest(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Request_"):
    guid: uint64
    seq: int64
    data: bool


@dataclass
@final
class SetResponse(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Response_"):
    guid: uint64
    seq: int64
    success: bool
    message: str


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
    names = {AddRequest: f"rq{service}Request", AddResponse: f"rr{service}Reply"}
    names |= {SetRequest: names[AddRequest], SetResponse: names[AddResponse]}
    reader = DataReader(participant, Topic(participant, names[reads], reads, qos=qos), qos=qos)
    writer = DataWriter(participant, Topic(participant, names[writes], writes, qos=qos), qos=qos)
    return reader, writer


def is_there(reader, writer):
    return bool(writer.get_matched_subscriptions() and reader.get_matched_publications())


def answer(service, request, response, body):
    """Answers each request with the result of `body`."""
    reader, writer = endpoints(service, request, response)
    say(event="ready")
    while True:
        for asked in reader.take(N=16):
            if isinstance(asked, request):
                writer.write(response(asked.guid, asked.seq, *body(asked)))
        time.sleep(0.002)


def reply(reader, kind, seq):
    """Returns the reply to a request, or None if it has not arrived."""
    while True:
        try:
            [sample] = reader.take(N=1) or [None]
        except Exception as error:
            # A reply to another vendor's client has no header. rmw_cyclonedds also drops what it
            # cannot read.
            print(f"not for us: {error!r}", file=sys.stderr)
            continue
        if sample is None or isinstance(sample, kind) and (sample.guid, sample.seq) == (CLIENT, seq):
            return sample


def serve(service):
    answer(service, AddRequest, AddResponse, lambda asked: [asked.a + asked.b])


def call(service):
    reader, writer = endpoints(service, AddResponse, AddRequest)
    say(event="ready")
    while not is_there(reader, writer):
        time.sleep(0.01)
    # Both ends must have discovered each other, but only one end's discovery is visible here.
    for attempt in range(100):
        writer.write(AddRequest(CLIENT, attempt, args.a, args.b))
        for _ in range(100):
            if answered := reply(reader, AddResponse, attempt):
                return say(event="reply", sum=answered.sum)
            time.sleep(0.002)


def switch(service):
    answer(service, SetRequest, SetResponse, lambda asked: [asked.data, f"{service} is {'on' if asked.data else 'off'}"])


def set(*services):
    ends = {service: endpoints(service, SetResponse, SetRequest) for service in services}
    for service, (reader, writer) in ends.items():
        while not is_there(reader, writer):
            time.sleep(0.01)
        for seq, value in enumerate([True, False]):
            writer.write(SetRequest(CLIENT, seq, value))
            while not (answered := reply(reader, SetResponse, seq)):
                time.sleep(0.01)
            say(event="response", service=service, success=answered.success, message=answered.message)
    while ends:
        for service in [service for service, pair in ends.items() if not is_there(*pair)]:
            say(event="gone", service=service)
            del ends[service]
        time.sleep(0.05)


p = argparse.ArgumentParser()
p.add_argument("verb", choices=["serve", "call", "switch", "set"])
p.add_argument("--service", nargs="+", default=["/add_two_ints"])
p.add_argument("--domain", type=int, default=0)
p.add_argument("--a", type=int, default=0)
p.add_argument("--b", type=int, default=0)
args = p.parse_args()
# Lets the participant announce its departure.
signal.signal(signal.SIGTERM, lambda *_: sys.exit())
participant = DomainParticipant(args.domain)
globals()[args.verb](*args.service)
