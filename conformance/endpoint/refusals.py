"""What the document says is refused, tried at a real switch by an endpoint without the right."""

import asyncio
import time
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric import ec

from . import files
from .certificates import issue
from .encoding import Refused, compressed, name_of, proof_of
from .exchange import WITHIN_S, say
from .link import Link, LinkClosed
from .node import Endpoint

NANOSECOND = 10**9


def stranger() -> Endpoint:
    return Endpoint(ec.generate_private_key(ec.SECP256R1()), "proxy")


async def code_of(action) -> str | None:
    try:
        await action
    except Refused as refused:
        return refused.code
    return None


class Cases:
    """Requests of a stranger that has other entities' certificates."""

    def __init__(self, endpoint: Endpoint, folder: Path):
        self.endpoint = endpoint
        self.name, self.proof = files.read_card(folder / "outward.card")
        self.ad = files.read_ad(folder / "outward.ad")
        self.inward_proof = files.read_card(folder / "inward.card")[1]
        self.grant = files.read_grant(folder / "inward.grant")

    def issued(self, signer: ec.EllipticCurvePrivateKey, **changed) -> dict:
        """Returns an AdCert for the stranger by this signer."""
        now = int(time.time())
        claims = {
            "name": self.name, "entity": self.endpoint.entity, "scope": [], "serial": now * NANOSECOND,
            "not_before": now, "not_after": now + 60, **changed,
        }
        return {"cert": issue("AdCert", claims, signer), "delegation": None}

    async def attach(self, **changed) -> None:
        claims = {"entity": self.endpoint.entity, "switch": self.endpoint.switch, "not_after": int(time.time()) + 60}
        certificate = issue("RtCert", claims | changed, self.endpoint.key)
        await self.endpoint.entity_request({"Attach": {"rt_cert": certificate, "resumes": False, "lane": 0}})

    async def own_name(self, last_serial: int | None = None, **changed) -> None:
        """Advertises a name of which the stranger itself is the owner."""
        owner = self.endpoint.key
        proof = proof_of(compressed(owner.public_key()), {"kind": "topic", "nonce": "a"})
        changed.setdefault("name", name_of(proof))
        serial = self.endpoint.serial
        if last_serial is not None:
            self.endpoint.serial = last_serial
        try:
            await self.endpoint.advertise(proof, self.issued(owner, **changed))
        finally:
            self.endpoint.serial = max(serial, self.endpoint.serial)

    async def raw(self, message) -> None:
        await self.endpoint.link.request(message)

    def before_attaching(self):
        return [
            ("a statement without an attachment", "NotAttached", lambda: self.own_name()),
            ("a prefix without an attachment", "NotEntitled", lambda: self.endpoint.query("ab")),
            ("an attachment that has ended", "Expired", lambda: self.attach(not_after=1)),
            ("an attachment to another switch", "WrongSwitch", lambda: self.attach(switch=bytes(32))),
            ("an attachment of another entity", "WrongEntity", lambda: self.attach(entity=bytes(32))),
        ]

    def after_attaching(self):
        now = int(time.time())
        advertise, subscribe = self.endpoint.advertise, self.endpoint.subscribe
        return [
            ("the right of another to publish", "WrongEntity", lambda: advertise(self.proof, self.ad)),
            ("the right of another to read", "WrongEntity", lambda: subscribe(self.inward_proof, self.grant)),
            ("a right that is not the owner's", "BadSignature",
             lambda: advertise(self.proof, self.issued(self.endpoint.key))),
            ("the right to another name", "WrongName", lambda: self.own_name(name=self.name)),
            ("a right that has ended", "Expired", lambda: self.own_name(not_before=1, not_after=2)),
            ("a right that begins later", "NotYetValid",
             lambda: self.own_name(not_before=now + 3600, not_after=now + 7200)),
            ("a right of the future", "NotYetValid", lambda: self.own_name(serial=(now + 3600) * NANOSECOND)),
            ("a right that holds", None, lambda: self.own_name()),
            ("a serial again", "ReplayedSerial", lambda: self.own_name(self.endpoint.serial - 1)),
            ("a request of a later release", "Unsupported", lambda: self.raw({"Teleport": {"to": 7}})),
            ("a text that is no request", "Malformed", lambda: self.raw(7)),
            ("a request of switches", "Malformed", lambda: self.raw(
                {"Detach": {"switch": bytes(32), "entity": bytes(32)}})),
        ]


class Greeting(Link):
    """A link whose hello differs from a valid one."""

    changed: dict

    def hello(self) -> dict:
        return super().hello() | self.changed


async def closed_by(
    host: str, port: int, changed: dict, alpn: list[str] | None = None, endpoint: Endpoint | None = None
) -> int | None:
    """Returns the code by which the switch closes a link with such a hello."""
    endpoint = endpoint or stranger()

    class Changed(Greeting):
        def __init__(self, *identity):
            super().__init__(*identity)
            self.changed = changed
            if alpn:
                self.quic.configuration.alpn_protocols = alpn

    try:
        link = await Changed.dial(host, port, endpoint.key, endpoint.proof["digest"], lambda _: None, None)
        async with asyncio.timeout(WITHIN_S):
            return (await link.closed).code
    except LinkClosed as closed:
        return closed.code


async def others(host: str, port: int) -> tuple[Endpoint, Endpoint, bytes]:
    """Returns a publisher and a reader of a name, and the name."""
    publisher, reader = stranger(), stranger()
    owner = publisher.key
    for endpoint in (publisher, reader):
        await endpoint.dial(host, port)
        await endpoint.attach()
    proof, now = proof_of(compressed(owner.public_key()), {"kind": "topic", "nonce": "b"}), int(time.time())
    terms = {"name": name_of(proof), "serial": now * NANOSECOND, "not_before": now, "not_after": now + 60}
    right = issue("AdCert", terms | {"entity": publisher.entity, "scope": []}, owner)
    grant = issue("ReadGrant", terms | {"to": {"entity": reader.entity}}, owner)
    await publisher.advertise(proof, {"cert": right, "delegation": None})
    await reader.subscribe(proof, {"grant": {"cert": grant, "delegation": None}, "member": None})
    return publisher, reader, name_of(proof)


async def error_about(endpoint: Endpoint, name: bytes) -> str:
    """Returns the reason of the error frame about data frames to a name."""
    endpoint.link.errors.clear()

    def answered() -> bool:
        endpoint.link.send(name, b"\x03")
        return bool(endpoint.link.errors)

    await endpoint.until(answered, WITHIN_S)
    return next(iter(endpoint.link.errors))


async def refusals(host: str, port: int, folder: Path) -> int:
    """Tries all cases, and returns 1 if the switch answers one otherwise than the document says."""
    endpoint, found = stranger(), []
    await endpoint.dial(host, port)
    cases = Cases(endpoint, folder)
    for case, expected, action in cases.before_attaching():
        found.append((case, expected, await code_of(action())))
    await endpoint.attach()
    for case, expected, action in cases.after_attaching():
        found.append((case, expected, await code_of(action())))
    found.append(("a frame to no name", "no_route", await error_about(endpoint, bytes(32))))
    publisher, reader, name = await others(host, port)
    found.append(("a frame to a name of another", "not_authorised", await error_about(endpoint, name)))
    again = await closed_by(host, port, {}, endpoint=endpoint)
    found.append(("a key that another program uses", 7, again))
    for ended in (publisher, reader, endpoint):
        await ended.close()
    found.append(("a hello with link id 0", 2, await closed_by(host, port, {"link_id": 0})))
    found.append(("a hello with lane 4", 2, await closed_by(host, port, {"lane": 4})))
    found.append(("the version before", 1, await closed_by(host, port, {}, ["gdp/1"])))
    for case, expected, answer in found:
        say(event="refusal", case=case, expected=expected, answer=answer)
    return 0 if all(expected == answer for _, expected, answer in found) else 1
