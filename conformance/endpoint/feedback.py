"""Feedback between a reader and a writer (`segments.md`, Feedback)."""

import secrets
import struct
from dataclasses import dataclass, field

from cryptography.exceptions import InvalidTag

from .encoding import Refused
from .keys import pair_cipher

VERSION = 0x82
WINDOW = 1024
PEER_SESSIONS = 4
HELLO, WELCOME, REPORT, NACK, GONE, CLOCK, TIME, NEWEST_KEY = range(1, 9)
NEWEST, EVERY, EVERY_IF_KEPT = range(3)
# Layouts behind kind and name, of kinds with one length.
LAYOUTS = {
    HELLO: struct.Struct(">16sB"),
    WELCOME: struct.Struct(">16s16sQI"),
    REPORT: struct.Struct(">16sQQQQQIQII"),
    GONE: struct.Struct(">16sQ"),
    CLOCK: struct.Struct(">16s16sQ"),
    TIME: struct.Struct(">16sQ"),
}
NACK_HEAD = struct.Struct(">16sQIIB")
RANGE = struct.Struct(">6sHII")


@dataclass(frozen=True)
class Feedback:
    kind: int
    name: bytes
    fields: tuple


def pack(message: Feedback) -> bytes:
    head = bytes([message.kind]) + message.name
    if message.kind == NACK:
        *fixed, ranges = message.fields
        packed = [RANGE.pack(sequence.to_bytes(6), cut, first, count) for sequence, cut, first, count in ranges]
        return head + NACK_HEAD.pack(*fixed, len(ranges)) + b"".join(packed)
    if message.kind == NEWEST_KEY:
        return head + len(message.fields[0]).to_bytes(2) + message.fields[0]
    return head + LAYOUTS[message.kind].pack(*message.fields)


def parse(data: bytes) -> list[Feedback]:
    """Returns the messages of a frame. If one is invalid, the whole frame is refused."""
    messages, offset = [], 0
    try:
        while offset < len(data):
            kind, name, offset = data[offset], data[offset + 1 : offset + 33], offset + 33
            if kind == NACK:
                *fixed, count = NACK_HEAD.unpack_from(data, offset)
                offset += NACK_HEAD.size
                ranges = [ranged(data, offset + i * RANGE.size) for i in range(count)]
                offset += count * RANGE.size
                check_ranges(ranges)
                fields = (*fixed, ranges)
            elif kind == NEWEST_KEY:
                length = int.from_bytes(data[offset : offset + 2])
                fields = (data[offset + 2 : offset + 2 + length],)
                offset += 2 + length
                if length > 768 or offset > len(data):
                    raise Refused("Malformed", "a key that is cut off or too long")
            else:
                fields = LAYOUTS[kind].unpack_from(data, offset)
                offset += LAYOUTS[kind].size
            messages.append(Feedback(kind, name, fields))
    except (KeyError, struct.error, IndexError) as error:
        raise Refused("Malformed", f"feedback: {error}") from error
    if not messages:
        raise Refused("Malformed", "feedback without a message")
    return messages


def ranged(data: bytes, offset: int) -> tuple[int, int, int, int]:
    sequence, cut, first, count = RANGE.unpack_from(data, offset)
    return int.from_bytes(sequence), cut, first, count


def check_ranges(ranges: list) -> None:
    ends = [(sequence, first, first + count) for sequence, _, first, count in ranges]
    apart = all(a[0] < b[0] or (a[0] == b[0] and a[2] <= b[1]) for a, b in zip(ends, ends[1:], strict=False))
    if not 1 <= len(ranges) <= 62 or not apart or any(first >= end or end > 2**32 for _, first, end in ends):
        raise Refused("Malformed", "the ranges of a nack")


@dataclass
class Window:
    """The counters that were accepted: the highest, and those below it."""

    size: int = WINDOW
    highest: int = 0
    accepted: set = field(default_factory=set)

    def admits(self, counter: int) -> bool:
        return counter > 0 and counter > self.highest - self.size and counter not in self.accepted

    def accept(self, counter: int) -> None:
        self.accepted.add(counter)
        if counter > self.highest:
            self.highest = counter
            self.accepted = {c for c in self.accepted if c > counter - self.size}


class Channel:
    """Feedback to and from one peer."""

    def __init__(self, pair: bytes, own: bytes, peer: bytes, session: bytes | None = None):
        self.pair, self.own, self.peer = pair, own, peer
        self.session = session or secrets.token_bytes(8)
        self.cipher = pair_cipher(pair, self.session, own, peer)
        self.counter = 0
        # The peer's sessions, the most recently used last.
        self.peer_sessions: dict[bytes, Window] = {}
        self.abandoned: dict[bytes, None] = {}

    def seal(self, *messages: Feedback) -> bytes:
        self.counter += 1
        head = bytes([VERSION]) + self.session + self.counter.to_bytes(8)
        return head + self.cipher.encrypt(bytes(4) + head[9:], b"".join(map(pack, messages)), head)

    def open(self, payload: bytes) -> list[Feedback]:
        head, session, counter = payload[:17], payload[1:9], int.from_bytes(payload[9:17])
        if len(payload) < 33 or payload[0] != VERSION or session in self.abandoned:
            raise Refused("Malformed", "no feedback")
        window = self.peer_sessions.get(session, Window())
        if not window.admits(counter):
            raise Refused("Malformed", "feedback again")
        try:
            cipher = pair_cipher(self.pair, session, self.peer, self.own)
            plain = cipher.decrypt(bytes(4) + head[9:], payload[17:], head)
        except InvalidTag as error:
            raise Refused("BadSignature", "feedback does not decrypt") from error
        window.accept(counter)
        self.peer_sessions.pop(session, None)
        self.peer_sessions[session] = window
        if len(self.peer_sessions) > PEER_SESSIONS:
            oldest = next(iter(self.peer_sessions))
            del self.peer_sessions[oldest]
            self.abandoned[oldest] = None
            if len(self.abandoned) > 256:
                del self.abandoned[next(iter(self.abandoned))]
        return parse(plain)
