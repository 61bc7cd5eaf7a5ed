"""Frames: header, hop tag, link keys and the checks of an endpoint (`docs/wire-format/frames.md`)."""

import struct
from dataclasses import dataclass, field, replace

from .encoding import Refused, hkdf

HEADER = 96
WORDS = HEADER // 8
DATA, CONTROL, ERROR, PROBE, ECHO = range(5)
FRAME_VERSION = 2
WINDOW = 4080
ECT0, CE = 2, 3
M64 = 2**64 - 1
LAYOUT = struct.Struct(">BBBBHBBII8s8s32s32s")


class Dropped(Refused):
    """A frame that is dropped, with the counter that the document names."""

    def __init__(self, counter: str):
        super().__init__(counter, "the frame is dropped")


def siphash(key: bytes, data: bytes) -> int:
    """Returns SipHash-2-4 of data whose length is a multiple of 8."""
    k0, k1 = struct.unpack("<QQ", key)
    v0, v1 = k0 ^ 0x736F6D6570736575, k1 ^ 0x646F72616E646F6D
    v2, v3 = k0 ^ 0x6C7967656E657261, k1 ^ 0x7465646279746573
    words = [*struct.unpack(f"<{len(data) // 8}Q", data), (len(data) & 0xFF) << 56]
    for word in [*words, None]:
        rounds = 2
        if word is None:
            rounds, word = 4, 0
            v2 ^= 0xFF
        v3 ^= word
        for _ in range(rounds):
            v0 = (v0 + v1) & M64
            v1 = ((v1 << 13 | v1 >> 51) & M64) ^ v0
            v0 = (v0 << 32 | v0 >> 32) & M64
            v2 = (v2 + v3) & M64
            v3 = ((v3 << 16 | v3 >> 48) & M64) ^ v2
            v0 = (v0 + v3) & M64
            v3 = ((v3 << 21 | v3 >> 43) & M64) ^ v0
            v2 = (v2 + v1) & M64
            v1 = ((v1 << 17 | v1 >> 47) & M64) ^ v2
            v2 = (v2 << 32 | v2 >> 32) & M64
        v0 ^= word
    return v0 ^ v1 ^ v2 ^ v3


@dataclass(frozen=True)
class Frame:
    kind: int
    destination: bytes
    source: bytes
    payload: bytes = b""
    flags: int = 0
    hop_limit: int = 64
    egress_set: int = 0
    egress_bits: bytes = bytes(8)
    reserved: int = 0

    def seal(self, key: bytes, link_id: int, count: int) -> bytes:
        """Returns the frame on a link: `count` is its number there, from 1."""
        parts = (
            FRAME_VERSION << 4 | self.kind, self.flags, self.hop_limit, self.egress_set, len(self.payload), WORDS,
            self.reserved, link_id, count & 0xFFFFFFFF,
        )
        tail = (self.egress_bits, self.destination, self.source)
        tag = hop_tag(key, LAYOUT.pack(*parts, bytes(8), *tail), count)
        return LAYOUT.pack(*parts, tag, *tail) + self.payload


def hop_tag(key: bytes, header: bytes, count: int) -> bytes:
    link_id = int.from_bytes(header[8:12]) ^ count >> 32
    covered = header[:8] + link_id.to_bytes(4) + header[12:16] + header[24:64]
    return siphash(key, covered).to_bytes(8)


def link_secrets(secret: bytes):
    """Yields secret and key of each generation of one direction of a link."""
    while True:
        yield secret, hkdf(secret, b"gdp/link-key/1")[:16]
        secret = hkdf(secret, b"gdp/link-secret/1")


@dataclass
class Receiver:
    """The receiving end of a link: keys by phase, and the counts that came."""

    link_id: int
    keys: list
    highest: int = 0
    accepted: set = field(default_factory=set)

    def count_of(self, low: int) -> int:
        """Infers the high bits of a link counter as those nearest to the highest count."""
        candidate = self.highest & ~0xFFFFFFFF | low
        nearest = min((candidate - 2**32, candidate, candidate + 2**32), key=lambda c: abs(c - self.highest))
        return max(nearest, low)

    def accept(self, count: int) -> None:
        self.accepted.add(count)
        if count > self.highest:
            self.highest = count
            if len(self.accepted) > 2 * WINDOW:
                self.accepted = {c for c in self.accepted if c > count - WINDOW - 16}

    def open(self, data: bytes) -> Frame:
        """Checks a frame in the order of the document, up to the replay check."""
        if not data or data[0] >> 4 != FRAME_VERSION or data[0] & 15 not in (DATA, ERROR, PROBE, ECHO):
            raise Dropped("drop_unknown")
        if len(data) < HEADER or len(data) < HEADER + int.from_bytes(data[4:6]):
            raise Dropped("drop_truncated")
        header = data[:HEADER]
        first, flags, hops, egress_set, length, words, reserved, link, low, *rest = LAYOUT.unpack(header)
        tag, bits, to, source = rest
        if words != WORDS:
            raise Dropped("drop_unknown")
        if link != self.link_id:
            raise Dropped("drop_no_link")
        key, count = self.keys[flags >> 7], self.count_of(low)
        if not any(key) or hop_tag(key, header, count) != tag:
            raise Dropped("drop_bad_tag")
        if count in self.accepted or count <= self.highest - WINDOW - 1:
            raise Dropped("drop_replayed")
        self.accept(count)
        payload = data[HEADER : HEADER + length]
        return Frame(first & 15, to, source, payload, flags, hops, egress_set, bits, reserved)


def echo(cookie: bytes) -> Frame:
    return Frame(ECHO, bytes(32), bytes(32), flags=0, hop_limit=1, egress_bits=cookie)


def echo_answer(question: Frame) -> Frame:
    return replace(question, egress_set=1, payload=b"", flags=question.flags & 0x1C)


ERRORS = {1: "no_route", 2: "too_big", 3: "hop_limit", 4: "not_authorised"}


def error_of(frame: Frame) -> tuple[str, int, int]:
    """Returns the reason, the MTU (or 0) and the link counter of an error frame."""
    if frame.egress_set not in ERRORS:
        raise Dropped("drop_unknown")
    return ERRORS[frame.egress_set], int.from_bytes(frame.egress_bits[:4]), int.from_bytes(frame.egress_bits[4:])
