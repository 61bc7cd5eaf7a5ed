"""Sealed segments: messages, bundles, heartbeats and their proofs (`docs/wire-format/segments.md`)."""

import struct
from dataclasses import dataclass

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from .encoding import Refused, hkdf, sha256
from .signing import sign, verify

VERSION = 3
BODY, LAST, HEARTBEAT, BUNDLE = range(4)
HEADER = 44
TAG = 16
PROOF = 68
MAX_DEPTH = 16
HEARTBEAT_CUT = 65535
LAYOUT = struct.Struct(">BBHI6sH16sIII")
HEAD = struct.Struct(">HH")
BUNDLED = struct.Struct(">HHH")
IN_REPLY_TO, ORIGIN, LATCHED, SERVICE = 1, 2, 3, 4
LENGTHS = {IN_REPLY_TO: range(24, 25), ORIGIN: range(1, 65), LATCHED: range(16, 17), SERVICE: range(32, 33)}


@dataclass(frozen=True)
class Message:
    timestamp: int
    encoding: int
    body: bytes
    extensions: tuple[tuple[int, bytes], ...] = ()

    def packed_extensions(self) -> bytes:
        return b"".join(HEAD.pack(kind, len(value)) + value for kind, value in sorted(self.extensions))

    def pack(self) -> bytes:
        extensions = self.packed_extensions()
        return self.timestamp.to_bytes(8) + HEAD.pack(self.encoding, len(extensions)) + extensions + self.body

    def pack_bundled(self) -> bytes:
        extensions = self.packed_extensions()
        return BUNDLED.pack(self.encoding, len(extensions), len(self.body)) + extensions + self.body


def parse_extensions(data: bytes) -> tuple[tuple[int, bytes], ...]:
    found, offset = [], 0
    while offset < len(data):
        if offset + 4 > len(data):
            raise Refused("Malformed", "an extension is cut off")
        kind, length = HEAD.unpack_from(data, offset)
        value, offset = data[offset + 4 : offset + 4 + length], offset + 4 + length
        if offset > len(data):
            raise Refused("Malformed", "an extension is cut off")
        if kind in LENGTHS:
            if length not in LENGTHS[kind] or kind in [known for known, _ in found]:
                raise Refused("Malformed", f"extension {kind}")
            found.append((kind, value))
        elif kind >= 0x8000:
            raise Refused("seal_unsupported", f"critical extension {kind:#06x}")
    return tuple(found)


def parse_message(data: bytes) -> Message:
    if len(data) < 12:
        raise Refused("Malformed", "a message has at least 12 bytes")
    encoding, length = HEAD.unpack_from(data, 8)
    if 12 + length > len(data):
        raise Refused("Malformed", "extensions are cut off")
    return Message(int.from_bytes(data[:8]), encoding, data[12 + length :], parse_extensions(data[12 : 12 + length]))


def parse_bundle(data: bytes, count: int) -> list[Message]:
    timestamp, offset, messages = int.from_bytes(data[:8]), 8, []
    for _ in range(count):
        if offset + 6 > len(data):
            raise Refused("Malformed", "a bundle is cut off")
        encoding, extensions, body = BUNDLED.unpack_from(data, offset)
        middle = offset + 6 + extensions
        if middle + body > len(data):
            raise Refused("Malformed", "a bundle is cut off")
        known = parse_extensions(data[offset + 6 : middle])
        messages.append(Message(timestamp, encoding, data[middle : middle + body], known))
        offset = middle + body
    if offset != len(data):
        raise Refused("Malformed", "bytes behind a bundle")
    return messages


@dataclass(frozen=True)
class Header:
    kind: int
    length: int
    index: int
    sequence: int
    cut: int
    session: bytes
    count: int
    size: int
    epoch: int

    def pack(self) -> bytes:
        return LAYOUT.pack(
            VERSION, self.kind, self.length, self.index, self.sequence.to_bytes(6), self.cut, self.session, self.count,
            self.size, self.epoch,
        )


def check_bounds(head: Header) -> None:
    """Checks what the document says about the fields of each kind."""
    plain, common = head.length - TAG, head.sequence >= 1
    if head.kind == HEARTBEAT:
        good = head.cut == HEARTBEAT_CUT and head.index >= 1 and head.count == head.size == 0 and plain == 80
    elif head.kind == BUNDLE:
        good = head.cut < HEARTBEAT_CUT and head.index == 0 and head.count >= 2 and head.size >= 8 + 6 * head.count
        good = good and plain >= head.size + PROOF
    else:
        good = head.cut < HEARTBEAT_CUT and head.count >= 1 and 1 <= head.size <= 65519 and head.index < head.count
        if head.kind == LAST:
            good = good and head.index == head.count - 1 and PROOF <= plain <= head.size + PROOF + 32 * MAX_DEPTH
            good = good and (head.count > 1 or plain >= head.size + PROOF)
        else:
            exact = head.index < head.count - 2
            good = good and head.index < head.count - 1 and (plain == head.size if exact else 1 <= plain <= head.size)
    if not (good and common):
        raise Refused("Malformed", "the bounds of a segment")


def split(payload: bytes) -> list[tuple[Header, bytes, bytes]]:
    """Returns header, its bytes (the additional data) and ciphertext of each segment."""
    found, offset = [], 0
    while offset < len(payload):
        if payload[offset] != VERSION:
            raise Refused("seal_other_version", f"version {payload[offset]}")
        if offset + HEADER > len(payload):
            raise Refused("Malformed", "a segment is cut off")
        clear = payload[offset : offset + HEADER]
        _, kind, length, index, sequence, cut, session, count, size, epoch = LAYOUT.unpack(clear)
        if kind & 15 > BUNDLE:
            raise Refused("seal_unsupported", f"kind {kind & 15}")
        head = Header(kind & 15, length, index, int.from_bytes(sequence), cut, session, count, size, epoch)
        offset += HEADER + length
        if offset > len(payload):
            raise Refused("Malformed", "a segment is cut off")
        check_bounds(head)
        found.append((head, clear, payload[offset - length : offset]))
    return found


class SessionKeys:
    """What seals and opens the segments of one epoch in one session."""

    def __init__(self, epoch_key: bytes, session: bytes, name: bytes, writer: bytes):
        self.session, self.name, self.writer = session, name, writer
        self.key = hkdf(epoch_key, b"gdp/session/1" + name + writer, session)
        self.commitment = hkdf(epoch_key, b"gdp/commit/1" + name + writer, session)
        self.cipher = AESGCM(self.key)

    def seal(self, head: Header, plain: bytes) -> bytes:
        clear = head.pack()
        return clear + self.cipher.encrypt(clear[8:16] + clear[4:8], plain, clear)

    def open(self, clear: bytes, ciphertext: bytes) -> bytes:
        try:
            return self.cipher.decrypt(clear[8:16] + clear[4:8], ciphertext, clear)
        except InvalidTag as error:
            raise Refused("BadSignature", "a segment does not open") from error

    def leaf(self, context: bytes, signed: bytes, parts: list[bytes]) -> bytes:
        """Returns a leaf over bytes 8 to 43 of the header and the plaintexts without the proof."""
        digests = b"".join(map(sha256, parts))
        return sha256(b"\0", context, self.commitment, self.name, self.writer, signed, digests)


def context_of(kind: int) -> bytes:
    return b"gdp/bundle/2" if kind == BUNDLE else b"gdp/message/2"


def tree(leaves: list[bytes]) -> list[list[bytes]]:
    """Returns the levels of a Merkle tree, from the padded leaves to the root."""
    width = 1 << (len(leaves) - 1).bit_length()
    levels = [leaves + [bytes(32)] * (width - len(leaves))]
    while len(levels[-1]) > 1:
        below = levels[-1]
        levels.append([sha256(b"\1", *below[i : i + 2]) for i in range(0, len(below), 2)])
    return levels


def proofs(leaves: list[bytes], signing_key) -> list[bytes]:
    """Returns the proof of each leaf under one signature."""
    levels = tree(leaves)
    signature = sign(signing_key, b"gdp/batch/2" + levels[-1][0])
    depth = len(levels) - 1
    paths = [b"".join(levels[i][position >> i ^ 1] for i in range(depth)) for position in range(len(leaves))]
    return [path + signature + struct.pack(">HBB", position, depth, 0) for position, path in enumerate(paths)]


def split_proof(plain: bytes) -> tuple[bytes, bytes]:
    """Returns what precedes the proof in the last segment, and the proof."""
    depth = plain[-2]
    length = PROOF + 32 * depth
    if depth > MAX_DEPTH or plain[-1] != 0 or len(plain) < length:
        raise Refused("Malformed", "a proof")
    return plain[:-length], plain[-length:]


def check_proof(leaf: bytes, proof: bytes, verify_key) -> None:
    position, depth, _ = struct.unpack(">HBB", proof[-4:])
    if position >> depth:
        raise Refused("Malformed", "the position of a leaf")
    node = leaf
    for level in range(depth):
        sibling = proof[32 * level : 32 * level + 32]
        left, right = (sibling, node) if position >> level & 1 else (node, sibling)
        node = sha256(b"\1", left, right)
    verify(verify_key, proof[-PROOF:-4], b"gdp/batch/2" + node)


@dataclass
class Draft:
    """A leaf that has no proof yet: segments before the last one, and what the last one begins with."""

    heads: list[Header]
    parts: list[bytes]
    leaf: bytes

    def seal(self, keys: SessionKeys, proof: bytes) -> list[bytes]:
        plains = [*self.parts[:-1], self.parts[-1] + proof]
        return [keys.seal(head, plain) for head, plain in zip(self.heads, plains, strict=True)]


def draft_message(
    keys: SessionKeys, message: Message, epoch: int, sequence: int, payload: int, cut: int = 0, proof: int = PROOF
) -> Draft:
    """Cuts a message for payloads of at most `payload` bytes; its proof will have `proof` bytes."""
    whole, room = message.pack(), payload - HEADER - TAG
    size = min(len(whole), room)
    parts = [whole[i : i + size] for i in range(0, len(whole), size)]
    if len(parts[-1]) + proof > room:
        parts.append(b"")
    lengths = [len(part) + TAG for part in parts]
    lengths[-1] += proof
    count = len(parts)
    heads = [
        Header(LAST if i == count - 1 else BODY, lengths[i], i, sequence, cut, keys.session, count, size, epoch)
        for i in range(count)
    ]
    leaf = keys.leaf(context_of(LAST), heads[0].pack()[8:44], parts)
    return Draft(heads, parts, leaf)


def draft_bundle(keys: SessionKeys, messages: list[Message], epoch: int, first: int, cut: int = 0) -> Draft:
    plain = messages[0].timestamp.to_bytes(8) + b"".join(message.pack_bundled() for message in messages)
    length = len(plain) + PROOF + TAG
    head = Header(BUNDLE, length, 0, first, cut, keys.session, len(messages), len(plain), epoch)
    return Draft([head], [plain], keys.leaf(context_of(BUNDLE), head.pack()[8:44], [plain]))


def heartbeat_signed(keys: SessionKeys, clear: bytes, plain: bytes) -> bytes:
    return b"gdp/heartbeat/1" + keys.name + keys.writer + clear[4:32] + plain[:16]


def seal_heartbeat(
    keys: SessionKeys, epoch: int, number: int, following: int, oldest: int, timestamp: int, signing_key
) -> bytes:
    head = Header(HEARTBEAT, 80 + TAG, number, following, HEARTBEAT_CUT, keys.session, 0, 0, epoch)
    plain = timestamp.to_bytes(8) + oldest.to_bytes(8)
    return keys.seal(head, plain + sign(signing_key, heartbeat_signed(keys, head.pack(), plain)))


def open_heartbeat(keys: SessionKeys, clear: bytes, plain: bytes, verify_key) -> tuple[int, int]:
    """Returns timestamp and the sequence of the oldest message that can be had again."""
    verify(verify_key, plain[16:], heartbeat_signed(keys, clear, plain))
    return int.from_bytes(plain[:8]), int.from_bytes(plain[8:16])


def open_whole(keys: SessionKeys, head: Header, clear: bytes, plains: list[bytes], verify_key) -> list[Message]:
    """Verifies all plaintexts of a leaf, in order, and returns its messages."""
    last, proof = split_proof(plains[-1])
    parts = [*plains[:-1], last]
    lengths = [len(part) for part in parts]
    if head.kind == BUNDLE or head.count == 1:
        exact = lengths == [head.size]
    else:
        before_full = lengths[-2] == head.size or (lengths[-1] == 0 and 1 <= lengths[-2] <= head.size)
        exact = before_full and lengths[-1] <= head.size and all(n == head.size for n in lengths[:-2])
    if not exact:
        raise Refused("Malformed", "the sizes of the segments")
    check_proof(keys.leaf(context_of(head.kind), clear[8:44], parts), proof, verify_key)
    if head.kind == BUNDLE:
        return parse_bundle(last, head.count)
    return [parse_message(b"".join(parts))]
