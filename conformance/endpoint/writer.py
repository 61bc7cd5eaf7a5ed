"""A writer of one name: epoch, wrapped keys, messages, repair (`segments.md`, `machines.md`)."""

import secrets
import time

from . import feedback
from .certificates import issue
from .feedback import Feedback
from .keys import wrap, wrap_info
from .segments import Message, SessionKeys, draft_message, proofs, seal_heartbeat

KEPT = 2048
FRAME_HEADER = 96


class Writer:
    """Has no sockets and no timers: the caller sends what it returns, and asks when it is due."""

    def __init__(self, name: bytes, entity: bytes, signing_key):
        self.name, self.entity, self.signing_key = name, entity, signing_key
        self.session = secrets.token_bytes(16)
        self.sequence, self.beats = 0, 0
        self.begin_epoch(int(time.time()))
        # Segments of the messages that can be had again, by sequence.
        self.kept: dict[int, list[bytes]] = {}
        self.readers: dict[bytes, bytes] = {}
        self.confirmed: set[bytes] = set()
        self.done: dict[bytes, int] = {}
        self.last_sent, self.next_beat, self.wait = 0.0, 0.0, 0.1

    def begin_epoch(self, number: int) -> None:
        self.epoch, self.epoch_key = number, secrets.token_bytes(32)
        self.keys = SessionKeys(self.epoch_key, self.session, self.name, self.entity)

    def key_box(self, reader: bytes, box_key: bytes) -> bytes:
        """Returns the epoch key, wrapped for a reader."""
        sealed = wrap(self.epoch_key, box_key, wrap_info(self.name, self.entity, reader, self.epoch))
        claims = {"name": self.name, "writer": self.entity, "reader": reader, "epoch": self.epoch, "sealed": sealed}
        return issue("KeyBox", claims, self.signing_key)

    def readers_are(self, readers: dict[bytes, bytes]) -> list[bytes]:
        """Takes the readers with their box keys, and returns the KeyBoxes to store."""
        lost = set(self.readers) - set(readers)
        new = set(readers) - set(self.readers)
        if lost:
            # Who may read no more must not have the key of what follows.
            self.begin_epoch(max(self.epoch + 1, int(time.time())))
            self.confirmed -= lost
            new = set(readers)
        self.readers = dict(readers)
        return [self.key_box(reader, readers[reader]) for reader in sorted(new)]

    def publish(self, body: bytes, encoding: int, room: int) -> list[bytes]:
        """Returns the payloads of the next message, for frames of at most `room` bytes."""
        self.sequence += 1
        message = Message(time.time_ns(), encoding, body)
        draft = draft_message(self.keys, message, self.epoch, self.sequence, room - FRAME_HEADER)
        (proof,) = proofs([draft.leaf], self.signing_key)
        segments = draft.seal(self.keys, proof)
        self.kept[self.sequence] = segments
        self.kept.pop(self.sequence - KEPT, None)
        self.last_sent, self.wait = time.monotonic(), 0.1
        self.next_beat = self.last_sent + self.wait
        return segments

    def oldest(self) -> int:
        return next(iter(self.kept), self.sequence + 1)

    def handle(self, reader: bytes, message: Feedback) -> tuple[list[Feedback], list[bytes]]:
        """Returns what to answer as feedback, and which segments to send again."""
        if message.kind == feedback.HELLO:
            self.confirmed.add(reader)
            self.done.setdefault(reader, self.sequence)
            challenge, _ = message.fields
            welcome = (challenge, self.session, self.sequence + 1, KEPT)
            return [Feedback(feedback.WELCOME, self.name, welcome)], []
        if message.kind == feedback.CLOCK:
            session, challenge, _ = message.fields
            if session == self.session:
                return [Feedback(feedback.TIME, self.name, (challenge, time.time_ns()))], []
        if message.kind in (feedback.REPORT, feedback.NACK) and message.fields[0] == self.session:
            if message.kind == feedback.REPORT:
                self.done[reader] = max(self.done.get(reader, 0), message.fields[2])
                return [], []
            return self.repair(message.fields[-1])
        return [], []

    def repair(self, ranges: list) -> tuple[list[Feedback], list[bytes]]:
        again, gone = [], 0
        for sequence, _, first, count in ranges:
            if sequence in self.kept:
                again += self.kept[sequence][first : first + count]
            elif sequence <= self.sequence:
                gone = self.oldest()
        answer = [Feedback(feedback.GONE, self.name, (self.session, gone))] if gone else []
        return answer, again

    def acknowledged(self) -> bool:
        return all(self.done.get(reader, 0) >= self.sequence for reader in self.confirmed)

    def heartbeat(self, now: float) -> bytes | None:
        """Returns a heartbeat if one is due: some reader has not all messages."""
        if self.sequence == 0 or now < self.next_beat or self.acknowledged():
            return None
        self.wait = min(2 * self.wait, 1.0)
        self.next_beat, self.beats = now + self.wait, self.beats + 1
        return seal_heartbeat(
            self.keys, self.epoch, self.beats, self.sequence + 1, self.oldest(), time.time_ns(), self.signing_key
        )
