"""Numbered messages between this endpoint and another, in both directions."""

import asyncio
import json
from dataclasses import dataclass, field
from pathlib import Path

from . import files
from .encoding import Refused, name_of
from .node import Endpoint
from .segments import Message

WITHIN_S = 30.0
PACE = 16


def body_of(number: int) -> bytes:
    """Returns the body of a numbered message: every hundredth needs several segments."""
    length = 5000 if number % 100 == 0 else number % 200
    return number.to_bytes(8) + bytes([number % 256]) * length


def say(**event) -> None:
    print(json.dumps(event), flush=True)


@dataclass
class Received:
    """The numbers of the messages that came, in the order of their delivery."""

    numbers: list[int] = field(default_factory=list)
    damaged: int = 0

    def take(self, _name: bytes, _writer: bytes, _sequence: int, message: Message) -> None:
        number = int.from_bytes(message.body[:8])
        self.numbers.append(number)
        self.damaged += message.body != body_of(number)


async def attached(host: str, port: int, key: Path) -> Endpoint:
    endpoint = Endpoint(*files.read_key(key))
    await endpoint.dial(host, port)
    await endpoint.attach()
    return endpoint


async def exchange(host: str, port: int, folder: Path, count: int, lose: int) -> int:
    """Publishes `outward.card` and reads `inward.card` of the folder, `count` messages each."""
    endpoint, received = await attached(host, port, folder / "id.pem"), Received()
    endpoint.deliver = received.take
    await endpoint.link.echo()
    endpoint.link.lose = lose
    outward, outward_proof = files.read_card(folder / "outward.card")
    inward, inward_proof = files.read_card(folder / "inward.card")
    writer = await endpoint.advertise(outward_proof, files.read_ad(folder / "outward.ad"))
    await endpoint.subscribe(inward_proof, files.read_grant(folder / "inward.grant"))
    say(event="attached", switch=endpoint.switch.hex(), entity=endpoint.entity.hex())
    await endpoint.until(lambda: bool(writer.confirmed), WITHIN_S)
    for number in range(1, count + 1):
        endpoint.publish(outward, body_of(number))
        if number % PACE == 0:
            await asyncio.sleep(0.001)
    await endpoint.until(writer.acknowledged, WITHIN_S)
    say(event="acknowledged", messages=writer.sequence)
    await endpoint.until(lambda: len(received.numbers) >= count, WITHIN_S)
    numbers = received.numbers
    complete = sorted(numbers) == list(range(1, count + 1)) and received.damaged == 0
    say(event="received", messages=len(numbers), damaged=received.damaged, complete=complete)
    records = await endpoint.query(outward.hex()) + await endpoint.query(inward.hex()[:8])
    say(event="records", entities=sorted({name_of(record["entity"]).hex() for record in records}))
    drops = [endpoint.dropped, endpoint.link.dropped, *(reader.dropped for reader in endpoint.readers.values())]
    say(event="done", drops=drops, errors=endpoint.link.errors)
    await endpoint.until(lambda: (folder / "stop").exists(), WITHIN_S)
    for name in (outward, inward):
        await endpoint.withdraw(name)
    left = [record for record in await endpoint.query(outward.hex()) if record["entity"] == endpoint.proof]
    if left:
        raise Refused("Malformed", "the statement is still there after it was withdrawn")
    await endpoint.close()
    return 0 if complete else 1
