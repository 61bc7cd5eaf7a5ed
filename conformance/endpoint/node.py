"""An endpoint: attachment, statements, messages (`docs/wire-format/machines.md`)."""

import asyncio
import time
from collections.abc import Callable

from . import segments
from .certificates import issue, open_certificate
from .encoding import Refused, compressed, load_public, name_of, proof_of
from .feedback import VERSION as FEEDBACK
from .feedback import Channel
from .frames import CE, Frame
from .keys import box_key, box_public, pair_key
from .link import Link
from .peers import Counterpart, Counterparts, verify_record
from .reader import EARLY_S, Reader
from .segments import Message
from .writer import Writer

LIFETIME_S = 86400
PUMP_S = 0.01
MAX_EARLY = 1024
BYTES = 0


class Endpoint:
    """One entity with one link. It neither dials again nor renews its statements."""

    def __init__(self, key, kind: str):
        self.key, self.proof = key, proof_of(compressed(key.public_key()), {"kind": kind})
        self.entity = name_of(self.proof)
        self.box_key = box_key(key)
        self.serial = 0
        self.writers: dict[bytes, Writer] = {}
        self.readers: dict[tuple[bytes, bytes], Reader] = {}
        self.states: dict[tuple[bytes, str], Counterparts] = {}
        self.channels: dict[bytes, Channel] = {}
        self.early: list[tuple[float, Frame]] = []
        self.dropped: dict[str, int] = {}
        self.deliver: Callable[[bytes, bytes, int, Message], None] = lambda name, writer, sequence, message: None

    async def dial(self, host: str, port: int) -> None:
        identity = (self.key, self.proof["digest"], self.frame_received, self.answer)
        self.link = await Link.dial(host, port, *identity)
        self.switch = self.link.peer
        self.link.start(self.pump())

    async def attach(self, until: int = LIFETIME_S) -> None:
        claims = {"entity": self.entity, "switch": self.switch, "not_after": int(time.time()) + until}
        attach = {"rt_cert": issue("RtCert", claims, self.key), "resumes": False, "lane": 0}
        _, answer = await self.entity_request({"Attach": attach})
        self.serial = max(self.serial, answer["serial"])

    async def entity_request(self, request: dict) -> tuple[str, object]:
        return await self.link.request({"Entity": request})

    def advert(self, operation: str, name: bytes) -> bytes:
        self.serial += 1
        claims = {
            "op": operation, "name": name, "entity": self.entity, "switch": self.switch, "serial": self.serial,
            "lifetime": LIFETIME_S, "box_key": box_public(self.key),
        }
        return issue("Advert", claims, self.key)

    async def advertise(self, proof: dict, ad_cert: dict) -> Writer:
        """States that this entity publishes a name."""
        name = name_of(proof)
        advert = self.advert("publish", name)
        statement = {"proof": proof, "ad_cert": ad_cert, "advert": advert, "everywhere": False}
        _, peers = await self.entity_request({"Advertise": statement})
        self.writers[name] = Writer(name, self.entity, self.key)
        await self.state(Counterparts(name, proof["owner_key"], "publisher"), peers)
        return self.writers[name]

    async def subscribe(self, proof: dict, reading: dict) -> None:
        """States that this entity reads a name."""
        name = name_of(proof)
        advert = self.advert("subscribe", name)
        statement = {"proof": proof, "grant": reading, "advert": advert, "everywhere": False}
        _, peers = await self.entity_request({"Subscribe": statement})
        await self.state(Counterparts(name, proof["owner_key"], "subscriber"), peers)

    async def state(self, counterparts: Counterparts, peers: dict) -> None:
        self.states[counterparts.name, counterparts.role] = counterparts
        await self.apply(counterparts, peers)

    async def withdraw(self, name: bytes) -> None:
        await self.entity_request({"Withdraw": {"advert": self.advert("withdraw", name)}})
        self.writers.pop(name, None)
        for place in [place for place in self.states if place[0] == name]:
            del self.states[place]
        for place in [place for place in self.readers if place[0] == name]:
            del self.readers[place]

    async def query(self, prefix: str) -> list[dict]:
        """Returns the records of a name or prefix, each verified again."""
        found, after = [], None
        while True:
            _, answer = await self.entity_request({"Query": {"prefix": prefix, "after": after}})
            for record in answer["records"]:
                verify_record(record, None, None)
                found.append(record)
            if not answer["truncated"] or not answer["records"]:
                return found
            after = key_of(answer["records"][-1])

    async def answer(self, title: str, data) -> object:
        """Answers a request of the switch."""
        match title:
            case "Peers" if data["entity"] == self.entity:
                counterparts = self.states.get((data["name"], data["role"]))
                if counterparts is None:
                    raise Refused("NotFound", "this entity does not use the name so")
                await self.apply(counterparts, data["peers"])
            case "Detach" if data["entity"] == self.entity:
                await self.attach()
            case "DomainRevoked" | "Papers" | "Costs":
                pass
            case _:
                raise Refused("Unsupported", f"an endpoint does not expect {title}")
        return "Done"

    # Counterparts.

    async def apply(self, counterparts: Counterparts, peers: dict) -> None:
        counterparts.apply(peers)
        if counterparts.role == "publisher":
            writer = self.writers[counterparts.name]
            readers = {entity: known.box_key for entity, known in counterparts.known.items()}
            boxes = writer.readers_are(readers)
            if boxes:
                # In a task of its own: the switch may await the answer to its request first.
                self.link.start(self.store(boxes))
        else:
            self.follow(counterparts)
            self.take_boxes(counterparts.name, peers["boxes"])
        for known in counterparts.known.values():
            self.channel(known)

    async def store(self, boxes: list[bytes]) -> None:
        for box in boxes:
            await self.entity_request({"KeyBoxes": {"boxes": [box]}})

    def follow(self, counterparts: Counterparts) -> None:
        name, known = counterparts.name, counterparts.known
        for place in [place for place in self.readers if place[0] == name and place[1] not in known]:
            del self.readers[place]
        for entity, counterpart in known.items():
            if (name, entity) not in self.readers:
                writer_key = load_public(counterpart.owner_key)
                self.readers[name, entity] = Reader(name, entity, writer_key, self.entity, self.box_key)
        now = time.monotonic()
        early, self.early = self.early, []
        for arrived, frame in early:
            if now - arrived < EARLY_S:
                self.frame_received(frame)

    def take_boxes(self, name: bytes, boxes: list[bytes]) -> None:
        for box in boxes:
            try:
                writer = open_certificate(box, "KeyBox").claims["writer"]
                if reader := self.readers.get((name, writer)):
                    reader.add_box(box, time.monotonic())
            except Refused as refused:
                self.drop(refused)

    def channel(self, known: Counterpart) -> None:
        if known.entity not in self.channels:
            pair = pair_key(self.box_key, self.entity, known.box_key, known.entity)
            self.channels[known.entity] = Channel(pair, self.entity, known.entity)

    # Frames.

    def drop(self, refused: Refused) -> None:
        self.dropped[refused.code] = self.dropped.get(refused.code, 0) + 1

    def frame_received(self, frame: Frame) -> None:
        try:
            if frame.destination == self.entity:
                self.feedback_received(frame)
            elif reader := self.readers.get((frame.destination, frame.source)):
                reader.receive(frame.payload, frame.flags & 3 == CE, time.monotonic())
            elif len(self.early) < MAX_EARLY and (frame.destination, "subscriber") in self.states:
                self.early.append((time.monotonic(), frame))
        except Refused as refused:
            self.drop(refused)

    def feedback_received(self, frame: Frame) -> None:
        if frame.payload[:1] == bytes([segments.VERSION]):
            raise Refused("Unsupported", "this endpoint has no services")
        if frame.payload[:1] != bytes([FEEDBACK]) or frame.source not in self.channels:
            raise Refused("NotEntitled", "feedback of an entity that is no counterpart")
        channel, now = self.channels[frame.source], time.monotonic()
        for message in channel.open(frame.payload):
            if writer := self.writers.get(message.name):
                if frame.source not in writer.readers:
                    continue
                answers, again = writer.handle(frame.source, message)
                for answer in answers:
                    self.link.send(frame.source, channel.seal(answer))
                self.send_segments(message.name, again)
            if reader := self.readers.get((message.name, frame.source)):
                reader.handle(message, now)

    def send_segments(self, name: bytes, sealed: list[bytes]) -> None:
        for segment in sealed:
            self.link.send(name, segment)

    def publish(self, name: bytes, body: bytes, encoding: int = BYTES) -> int:
        """Sends a message, and returns its sequence."""
        writer = self.writers[name]
        self.send_segments(name, writer.publish(body, encoding, self.link.mtu))
        return writer.sequence

    async def pump(self) -> None:
        """Sends feedback and heartbeats that are due, and delivers what has come."""
        while True:
            now, out = time.monotonic(), {}
            for (name, entity), reader in self.readers.items():
                for sequence, message in reader.delivered:
                    self.deliver(name, entity, sequence, message)
                reader.delivered.clear()
                out.setdefault(entity, []).extend(reader.due(now))
            for entity, messages in out.items():
                if messages and entity in self.channels:
                    for message in messages:
                        self.link.send(entity, self.channels[entity].seal(message))
            for name, writer in self.writers.items():
                if (beat := writer.heartbeat(now)) is not None:
                    self.link.send(name, beat)
            await asyncio.sleep(PUMP_S)

    async def until(self, condition: Callable[[], bool], within: float) -> None:
        async with asyncio.timeout(within):
            while not condition():
                await asyncio.sleep(PUMP_S)

    async def close(self) -> None:
        self.link.close()
        await self.link.closed


def key_of(record: dict) -> dict:
    """Returns the key of a record, by which a query continues."""
    operation = open_certificate(record["advert"], "Advert").claims["op"]
    role = {"publish": "publisher", "serve": "server", "subscribe": "subscriber", "call": "caller"}[operation]
    return {"name": record["name"], "role": role, "entity": name_of(record["entity"]), "switch": record["switch"]}
