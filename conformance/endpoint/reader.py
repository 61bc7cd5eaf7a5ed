"""A reader of one writer of a name: sessions, assembly, reports (`segments.md`, `machines.md`)."""

import secrets
import time
from dataclasses import dataclass, field

from . import feedback, segments
from .certificates import open_certificate
from .encoding import Refused, compressed
from .feedback import Feedback, Window
from .keys import unwrap, wrap_info

WHOLE = 2**32 - 1
REORDER_S = 0.02
NACK_S = 0.1
REPORT_AFTER_S, REPORT_APART_S = 0.02, 0.1
TOO_OLD_S = 60
OLDER_EPOCH_S = 60
EARLY_S, EARLY_BYTES = 1.0, 2 << 20
U32 = 2**32 - 1


@dataclass
class Pending:
    """The segments of one cut of a message that have come."""

    head: segments.Header
    clear: bytes
    plains: dict[int, bytes] = field(default_factory=dict)


@dataclass
class Session:
    """A session that the writer has confirmed, and what came in it."""

    begin: int
    window: Window = field(default_factory=lambda: Window(1024))
    pending: dict[tuple[int, int], Pending] = field(default_factory=dict)
    highest: int = 0
    done: int = 0
    finished: set[int] = field(default_factory=set)
    arrived: int = 0
    arrived_bytes: int = 0
    twice_bytes: int = 0
    marks: int = 0
    # Sequence, index and arrival of a segment: the last one since the last report, and the one
    # that was sent last.
    last: tuple[int, int, float] = (0, 0, 0.0)
    furthest: tuple[int, int, float] = (0, 0, 0.0)
    beat: int = 0
    missing_since: float | None = None

    def finish(self, sequence: int) -> None:
        self.finished.add(sequence)
        while self.done + 1 in self.finished:
            self.done += 1
            self.finished.discard(self.done)


class Reader:
    """Has no sockets and no timers: the caller sends the feedback that it returns."""

    def __init__(self, name: bytes, writer: bytes, writer_key, own: bytes, box_key):
        self.name, self.writer, self.writer_key = name, writer, writer_key
        self.own, self.box_key = own, box_key
        self.epochs: dict[int, tuple[bytes, float]] = {}
        self.keys: dict[tuple[int, bytes], segments.SessionKeys] = {}
        self.session_id: bytes | None = None
        self.session: Session | None = None
        self.delivered: list[tuple[int, segments.Message]] = []
        self.dropped: dict[str, int] = {}
        self.early: list[tuple[float, bytes, int]] = []
        self.challenge: bytes | None = None
        self.hello_at, self.hellos = 0.0, 0
        self.unreported_since: float | None = None
        self.reported_at = self.nacked_at = 0.0
        self.greet()

    def greet(self) -> None:
        """Asks for the session anew."""
        self.challenge, self.hello_at, self.hellos = secrets.token_bytes(16), 0.0, 0

    def add_box(self, data: bytes, now: float) -> None:
        """Opens a wrapped key of the writer, unless it is older than the epoch before the newest."""
        claims = open_certificate(data, "KeyBox", compressed(self.writer_key)).claims
        if (claims["name"], claims["writer"], claims["reader"]) != (self.name, self.writer, self.own):
            raise Refused("WrongName", "a wrapped key for others")
        epoch = claims["epoch"]
        info = wrap_info(self.name, self.writer, self.own, epoch)
        if len(self.epochs) >= 2 and epoch < min(self.epochs):
            raise Refused("Expired", "a wrapped key of an old epoch")
        self.epochs[epoch] = (unwrap(claims["sealed"], self.box_key, info), now)
        self.keys = {key: value for key, value in self.keys.items() if key[0] != epoch}
        while len(self.epochs) > 2:
            del self.epochs[min(self.epochs)]

    def receive(self, payload: bytes, marked: bool, now: float) -> None:
        """Takes the payload of a frame. Frames wait for key and welcome for a short time."""
        if self.session is None or not self.epochs:
            self.early = [kept for kept in self.early if now - kept[0] < EARLY_S]
            if sum(len(kept[1]) for kept in self.early) + len(payload) <= EARLY_BYTES:
                self.early.append((now, payload, marked))
            return
        counted = False
        for head, clear, ciphertext in segments.split(payload):
            try:
                self.segment(head, clear, ciphertext, now)
                counted = True
            except Refused as refused:
                self.dropped[refused.code] = self.dropped.get(refused.code, 0) + 1
        if marked and counted:
            self.session.marks += 1

    def segment(self, head: segments.Header, clear: bytes, ciphertext: bytes, now: float) -> None:
        keys = self.session_keys(head, now)
        plain = keys.open(clear, ciphertext)
        if head.session != self.session_id:
            if self.challenge is None:
                self.greet()
            raise Refused("unconfirmed", "a session that the writer has not confirmed")
        session = self.session
        if head.kind == segments.HEARTBEAT:
            self.heartbeat(session, keys, head, clear, plain, now)
            return
        if head.sequence < session.begin:
            raise Refused("unconfirmed", "a message from before the welcome")
        fresh = [head.sequence + i for i in range(head.count if head.kind == segments.BUNDLE else 1)]
        fresh = [sequence for sequence in fresh if session.window.admits(sequence)]
        if not fresh:
            session.twice_bytes += len(clear) + len(ciphertext)
            raise Refused("replayed", "a message that came before")
        self.count(session, head, len(clear) + len(ciphertext), fresh, now)
        pending = session.pending.setdefault((head.sequence, head.cut), Pending(head, clear))
        if (pending.head.count, pending.head.size, pending.head.epoch) != (head.count, head.size, head.epoch):
            raise Refused("Malformed", "segments of one cut that differ")
        pending.plains[head.index] = plain
        session.highest = max(session.highest, fresh[-1])
        whole = 1 if head.kind == segments.BUNDLE else head.count
        if len(pending.plains) == whole:
            del session.pending[head.sequence, head.cut]
            self.complete(session, keys, head, clear, [pending.plains[i] for i in range(whole)], fresh)

    def session_keys(self, head: segments.Header, now: float) -> segments.SessionKeys:
        newest = max(self.epochs)
        if head.epoch != newest and now - self.epochs[newest][1] > OLDER_EPOCH_S:
            self.epochs.pop(head.epoch, None)
        if head.epoch not in self.epochs:
            raise Refused("no_key", f"epoch {head.epoch}")
        place = (head.epoch, head.session)
        if place not in self.keys:
            if len(self.keys) >= 16:
                self.keys.clear()
            self.keys[place] = segments.SessionKeys(self.epochs[head.epoch][0], head.session, self.name, self.writer)
        return self.keys[place]

    def count(self, session: Session, head: segments.Header, length: int, fresh: list[int], now: float) -> None:
        # A bundle counts as a segment for each of its messages.
        session.arrived += len(fresh)
        session.arrived_bytes += length
        session.last = (fresh[-1], head.index, now)
        if session.last[:2] > session.furthest[:2]:
            session.furthest = session.last
        if self.unreported_since is None:
            self.unreported_since = now

    def complete(self, session, keys, head, clear, plains: list[bytes], fresh: list[int]) -> None:
        messages = segments.open_whole(keys, head, clear, plains, self.writer_key)
        for sequence, message in enumerate(messages, head.sequence):
            if sequence in fresh:
                if time.time_ns() - message.timestamp > TOO_OLD_S * 10**9:
                    raise Refused("too_old", "the signed timestamp")
                session.window.accept(sequence)
                session.finish(sequence)
                session.pending = {key: value for key, value in session.pending.items() if key[0] != sequence}
                self.delivered.append((sequence, message))

    def heartbeat(self, session, keys, head, clear: bytes, plain: bytes, now: float) -> None:
        if head.index <= session.beat:
            raise Refused("replayed", "a heartbeat that came before")
        segments.open_heartbeat(keys, clear, plain, self.writer_key)
        session.beat, session.highest = head.index, max(session.highest, head.sequence - 1)
        if self.unreported_since is None:
            self.unreported_since = now - REPORT_AFTER_S

    def handle(self, message: Feedback, now: float) -> None:
        """Takes feedback of the writer."""
        if message.kind == feedback.WELCOME and message.fields[0] == self.challenge:
            _, session, begin, _ = message.fields
            self.challenge = None
            if session != self.session_id:
                self.session_id = session
                self.session = Session(begin, highest=begin - 1, done=begin - 1)
            early, self.early = self.early, []
            for arrived, payload, marked in early:
                if now - arrived < EARLY_S:
                    self.receive(payload, marked, now)
        elif message.kind == feedback.GONE and message.fields[0] == self.session_id:
            for sequence in range(self.session.done + 1, min(message.fields[1], self.session.highest + 1)):
                self.session.finish(sequence)

    def due(self, now: float) -> list[Feedback]:
        """Returns the feedback that is due."""
        out = []
        if self.challenge is not None and now >= self.hello_at:
            self.hellos += 1
            self.hello_at = now + 0.1 * 2 ** max(0, min(self.hellos - 5, 8))
            out.append(Feedback(feedback.HELLO, self.name, (self.challenge, feedback.EVERY_IF_KEPT)))
        if self.session is None:
            return out
        if ranges := self.missing(now):
            self.nacked_at = now
            sequence, index, at = self.session.furthest
            nack = (self.session_id, sequence, index, micros(now, at), ranges)
            out.append(Feedback(feedback.NACK, self.name, nack))
        since = self.unreported_since
        if since is not None and now >= since + REPORT_AFTER_S and now >= self.reported_at + REPORT_APART_S:
            self.reported_at, self.unreported_since = now, None
            out.append(Feedback(feedback.REPORT, self.name, self.report(now)))
        return out

    def report(self, now: float) -> tuple:
        s = self.session
        (sequence, index, at), s.last = s.last, (0, 0, 0.0)
        return (
            self.session_id, s.highest, s.done, s.arrived, s.arrived_bytes, s.twice_bytes, s.marks, sequence, index,
            micros(now, at),
        )

    def missing(self, now: float) -> list[tuple[int, int, int, int]]:
        """Returns the ranges to ask for, once they are missing for longer than frames are reordered."""
        s = self.session
        if s.highest == s.done:
            s.missing_since = None
            return []
        s.missing_since = s.missing_since or now
        if now < s.missing_since + REORDER_S or now < self.nacked_at + NACK_S:
            return []
        ranges = []
        cuts = {sequence: (cut, pending) for (sequence, cut), pending in sorted(s.pending.items())}
        for sequence in range(s.done + 1, s.highest + 1):
            if sequence in s.finished:
                continue
            if sequence in cuts:
                cut, pending = cuts[sequence]
                absent = [index for index in range(pending.head.count) if index not in pending.plains]
                ranges += [(sequence, cut, index, 1) for index in absent]
            else:
                ranges.append((sequence, 0, 0, WHOLE))
            if len(ranges) >= 40:
                break
        return ranges[:40]


def micros(now: float, at: float) -> int:
    return min(int((now - at) * 1e6), U32) if at else 0
