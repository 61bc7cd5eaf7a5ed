"""Control messages: framing, shapes and refusals (`docs/wire-format/control.md`, `docs/gdp.cddl`).

Only what an endpoint receives is checked by its shape here. Other kinds are known by name.
"""

from .certificates import boolean, listed, name, number, or_null, record
from .encoding import Refused, decode, encode, is_bytes

MAX_MESSAGE = 65536
REQUESTS = {
    "Ready", "WatchCosts", "Entity", "Onward", "Relay", "Report", "Peerings", "Tier", "Flood", "Detach", "Fib",
    "Peers", "Costs", "Ratcheted", "Papers", "DomainRevoked", "Admitted", "Traced", "TraceOn", "Inspect",
}
ENTITY_REQUESTS = {"Attach", "Advertise", "Subscribe", "Withdraw", "KeyBoxes", "Revoke", "Query"}
RESPONSES = {"Done", "Attached", "Reported", "Records", "Peers", "Tier", "Costs", "TracedOn", "Inspected", "Refused"}
ROLES = ("publisher", "server", "subscriber", "caller")


def certificate(value) -> bool:
    return isinstance(value, bytes)


def proof(value) -> bool:
    return record(owner_key=lambda key: is_bytes(key, 33), digest=name)(value)


def fields(**wanted):
    """Checks the fields of a control message, which may have further ones."""
    return lambda value: isinstance(value, dict) and all(
        field in value and check(value[field]) for field, check in wanted.items()
    )


def renewable(value) -> bool:
    renewal = record(delegation=certificate, cert=certificate)
    plain = {"domain": proof, "cert": certificate, "invite": or_null(certificate)}
    return record(**plain)(value) or record(**plain, renewal=renewal)(value)


ISSUED = record(cert=certificate, delegation=or_null(certificate))
READING = record(grant=ISSUED, member=or_null(renewable))


def credential(value) -> bool:
    return record(Writer=ISSUED)(value) or record(Reader=READING)(value)


def role(value) -> bool:
    return value in ROLES


RECORD = fields(
    name=name, proof=proof, entity=proof, switch=name, credential=credential, advert=certificate, expires_in=number()
)


def extent(value) -> bool:
    part = record(part=number(0, 2**32 - 1), last=boolean)
    return record(After=number())(value) or record(Whole=part)(value)


PEERS = fields(
    run=number(), settling=boolean, generation=number(), extent=extent, records=listed(RECORD, MAX_MESSAGE),
    gone=listed(name, MAX_MESSAGE), revocation=or_null(certificate), boxes=listed(certificate, MAX_MESSAGE),
)


def costs(value) -> bool:
    return isinstance(value, dict) and all(name(key) and number()(cost) for key, cost in value.items())


def is_text(value) -> bool:
    return isinstance(value, str)


SHAPES = {
    "Report": fields(switch=proof),
    "Peers": fields(switch=name, entity=name, name=name, role=role, peers=PEERS),
    "Detach": fields(switch=name, entity=name),
    "Costs": costs,
    "Ratcheted": fields(generation=number()),
    "DomainRevoked": fields(proof=proof, revocation=certificate),
    "Papers": fields(membership=renewable, peers=listed(certificate, 16)),
}
ANSWERS = {
    "Attached": fields(serial=number()),
    "Peers": PEERS,
    "Records": fields(records=listed(RECORD, MAX_MESSAGE), truncated=boolean),
    "Refused": fields(code=is_text, reason=is_text),
    "Costs": costs,
}


def frame(message) -> bytes:
    """Returns a message with its length, as on a stream."""
    body = encode(message)
    return len(body).to_bytes(4) + body


def open_stream(data: bytes) -> bytes:
    """Returns the body of a whole stream."""
    length = int.from_bytes(data[:4])
    if length > MAX_MESSAGE:
        raise Refused("Malformed", f"{length} bytes exceed {MAX_MESSAGE}")
    if len(data) != 4 + length:
        raise Refused("Malformed", "the stream has another length")
    return data[4:]


def variant(value) -> tuple[str, object]:
    """Returns name and data of a choice; the data of a text are None."""
    if isinstance(value, str):
        return value, None
    if isinstance(value, dict) and len(value) == 1:
        ((title, data),) = value.items()
        if isinstance(title, str):
            return title, data
    raise Refused("Malformed", "no choice")


def check(title: str, data, shapes: dict) -> tuple[str, object]:
    if title in shapes and not shapes[title](data):
        raise Refused("Malformed", f"the fields of {title}")
    return title, data


def parse_request(body: bytes) -> tuple[str, object]:
    if len(body) > MAX_MESSAGE:
        raise Refused("Malformed", f"{len(body)} bytes exceed {MAX_MESSAGE}")
    title, data = variant(decode(body))
    if title not in REQUESTS:
        raise Refused("Unsupported", f"this release does not know {title}")
    if title == "Entity":
        inner, _ = variant(data)
        if inner not in ENTITY_REQUESTS:
            raise Refused("Unsupported", f"this release does not know {inner}")
    return check(title, data, SHAPES)


def parse_response(body: bytes) -> tuple[str, object]:
    title, data = variant(decode(body))
    if title not in RESPONSES:
        raise Refused("Unsupported", f"an unknown answer {title}")
    return check(title, data, ANSWERS)


def refusal(error: Refused) -> dict:
    return {"Refused": {"code": error.code, "reason": error.reason.encode()[:1024].decode(errors="ignore")}}
