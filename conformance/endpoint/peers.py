"""Counterparts of a name: records of the RIB, verified, and how lists follow (`control.md`)."""

import time
from dataclasses import dataclass, field

from .certificates import open_certificate
from .chains import check_reader, check_writer
from .encoding import Refused, name_of

MAX_COUNTERPARTS = 8192
OPERATIONS = {"publisher": "publish", "server": "serve", "subscriber": "subscribe", "caller": "call"}
COUNTERPARTS = {"publisher": "subscriber", "subscriber": "publisher", "server": "caller", "caller": "server"}


@dataclass(frozen=True)
class Counterpart:
    entity: bytes
    owner_key: bytes
    box_key: bytes


def verify_record(record: dict, role: str | None, revocation: dict | None) -> Counterpart:
    """Verifies a record as if nobody had before. `role` is that of the entity it is about, if known."""
    name, now_ns = record["name"], time.time_ns()
    if name_of(record["proof"]) != name:
        raise Refused("WrongName", "the proof derives another name")
    entity, owner = name_of(record["entity"]), record["proof"]["owner_key"]
    ((kind, chain),) = record["credential"].items()
    check = check_writer if kind == "Writer" else check_reader
    check(chain, name, owner, entity, now_ns, revocation)
    advert = open_certificate(record["advert"], "Advert", record["entity"]["owner_key"]).claims
    if (advert["name"], advert["entity"], advert["switch"]) != (name, entity, record["switch"]):
        raise Refused("WrongEntity", "the statement is about another name, entity or switch")
    allowed = ("publish", "serve") if kind == "Writer" else ("subscribe", "call")
    if advert["op"] not in allowed or (role and advert["op"] != OPERATIONS[role]):
        raise Refused("Malformed", f"the statement is to {advert['op']}")
    return Counterpart(entity, record["entity"]["owner_key"], advert["box_key"])


@dataclass
class Counterparts:
    """The counterparts of this entity in one name and role, as far as the RIB has announced them."""

    name: bytes
    owner_key: bytes
    role: str
    run: int | None = None
    generation: int = 0
    next_part: int | None = None
    known: dict[bytes, Counterpart] = field(default_factory=dict)
    named: set[bytes] = field(default_factory=set)
    revocation: dict | None = None
    refused: int = 0

    def apply(self, peers: dict) -> None:
        """Takes an answer or a notification. One that does not follow is refused."""
        ((kind, extent),) = peers["extent"].items()
        newer = peers["run"] != self.run or peers["generation"] > self.generation
        if kind == "After":
            if peers["run"] != self.run or extent != self.generation or self.next_part is not None:
                raise Refused("Malformed", "changes to another state")
        elif extent["part"] == 0:
            if not newer:
                raise Refused("Malformed", "an older list")
            self.named = set()
        elif peers["run"] != self.run or extent["part"] != self.next_part or not newer:
            raise Refused("Malformed", "a part that does not follow")
        self.run, self.generation = peers["run"], peers["generation"]
        if peers["revocation"] is not None:
            self.revoke(peers["revocation"])
        for record in peers["records"]:
            self.add(record)
        for entity in peers["gone"]:
            self.known.pop(entity, None)
        if kind == "Whole":
            self.next_part = None if extent["last"] else extent["part"] + 1
            if extent["last"] and not peers["settling"]:
                self.known = {entity: known for entity, known in self.known.items() if entity in self.named}

    def add(self, record: dict) -> None:
        """Takes one record. One that does not verify is left out."""
        try:
            if record["name"] != self.name:
                raise Refused("WrongName", "a record of another name")
            found = verify_record(record, COUNTERPARTS[self.role], self.revocation)
        except Refused:
            self.refused += 1
            return
        if len(self.known) < MAX_COUNTERPARTS or found.entity in self.known:
            self.known[found.entity] = found
            self.named.add(found.entity)

    def revoke(self, data: bytes) -> None:
        claims = open_certificate(data, "Revocation", self.owner_key).claims
        if claims["name"] == self.name and (not self.revocation or claims["number"] > self.revocation["number"]):
            self.revocation = claims
