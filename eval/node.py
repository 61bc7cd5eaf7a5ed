"""A ROS 2 node as rmw_cyclonedds makes it: one participant, its endpoints, its announcement."""

import ctypes
import os
import queue
import sys
import threading
import time
from dataclasses import dataclass

from cyclonedds._clayer import ddspy_take
from cyclonedds.core import InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState
from cyclonedds.core import WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import DDS
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import idl

# The receive thread gets the interpreter's lock from Python code within this time, in seconds.
# The default, 5 ms, would be added to a receipt time. README.md, "Receipt times", says which
# libraries release the lock.
SWITCH_INTERVAL = 0.0002
ANY = SampleState.Any | ViewState.Any | InstanceState.Any
DDS_RETCODE_TIMEOUT = -10


class Sample(ctypes.Structure):
    """What the binding passes to `dds_write`: an encoded message (`ddspy_sample_container`)."""

    _fields_ = [("data", ctypes.c_char_p), ("size", ctypes.c_size_t)]


# The binding's own `ddspy_write` holds the interpreter's lock while it sends. A foreign function
# releases it. The binding's C code that this calls uses no Python objects.
dds_write = DDS._dll_handle.dds_write
dds_write.argtypes = [ctypes.c_int32, ctypes.POINTER(Sample)]
dds_write.restype = ctypes.c_int32


class SendError(Exception):
    """A message that DDS did not accept."""


@dataclass(frozen=True)
class Received:
    topic: str
    payload: bytes
    #: CLOCK_MONOTONIC in nanoseconds, before the message was copied out of DDS.
    at: int


class Node:
    """`reads` and `writes` map ROS topic names to the message classes of `messages.py`."""

    def __init__(self, name, reads, writes):
        sys.setswitchinterval(SWITCH_INTERVAL)
        self.participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
        self.writers = {
            name: DataWriter(self.participant, self.topic(name, kind), qos=endpoint_qos())
            for name, kind in writes.items()
        }
        self.readers = {
            name: DataReader(self.participant, self.topic(name, kind), qos=endpoint_qos())
            for name, kind in reads.items()
        }
        self.announcement = self.announce(name)
        self.inbox = queue.SimpleQueue()
        threading.Thread(target=self.receive_all, daemon=True).start()

    def topic(self, name, kind):
        return Topic(self.participant, f"rt{name}", kind.IDL, qos=endpoint_qos())

    def announce(self, name):
        """Announces the node's endpoints on ros_discovery_info.

        The Zenoh bridge ignores endpoints that no node announces. The announcement lasts as long as
        the returned writer exists.
        """
        qos = Qos(
            Policy.Reliability.Reliable(duration(seconds=10)),
            Policy.Durability.TransientLocal,
            Policy.History.KeepLast(1),
            Policy.DataRepresentation(use_cdrv0_representation=True),
        )
        kind = idl.ParticipantEntitiesInfo_
        topic = Topic(self.participant, "ros_discovery_info", kind, qos=qos)
        writer = DataWriter(self.participant, topic, qos=qos)
        readers = [gid(reader) for reader in self.readers.values()]
        writers = [gid(writer) for writer in self.writers.values()]
        node = idl.NodeEntitiesInfo_("/", name, readers, writers)
        writer.write(kind(gid(self.participant), [node]))
        return writer

    def matched(self):
        return all(writer.get_matched_subscriptions() for writer in self.writers.values())

    def publish(self, topic, encoded):
        """Writes an encoded message. Raises `SendError` if DDS does not accept it."""
        # `DataWriter.write` would encode the message again, with the slow codec.
        sample = Sample(encoded.payload, len(encoded.payload))
        code = dds_write(self.writers[topic]._ref, ctypes.byref(sample))
        if code == DDS_RETCODE_TIMEOUT:
            raise SendError(f"{topic}: the readers acknowledged nothing for 10 s")
        if code < 0:
            raise SendError(f"{topic}: Cyclone DDS return code {code}")

    def receive(self, timeout):
        """Returns the next message of any topic, or None after `timeout` seconds."""
        try:
            return self.inbox.get(timeout=max(0.0, timeout))
        except queue.Empty:
            return None

    def receive_all(self):
        """Receives for ever, in a thread of its own, so that the receipt time is right."""
        waitset = WaitSet(self.participant)
        conditions = {
            name: ReadCondition(reader, ANY) for name, reader in self.readers.items()
        }
        for condition in conditions.values():
            waitset.attach(condition)
        while True:
            waitset.wait(duration(seconds=1))
            for name, reader in self.readers.items():
                while samples := self.take(name, reader):
                    for sample in samples:
                        self.inbox.put(sample)

    @staticmethod
    def take(name, reader):
        at = time.monotonic_ns()
        # One at a time: the receipt time of the next message must not precede its arrival by the
        # time that copying this one takes.
        samples = ddspy_take(reader._ref, ANY, 1)
        return [Received(name, body, at) for body, info in samples if info.valid_data]


def gid(entity):
    return idl.Gid_(list(entity.guid.bytes))


def endpoint_qos():
    return Qos(
        Policy.Reliability.Reliable(duration(seconds=10)),
        Policy.Durability.Volatile,
        Policy.History.KeepLast(10),
        # ROS 2 uses XCDR1 only.
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
