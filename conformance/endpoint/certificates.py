"""Certificates: kinds, fields, bounds and signatures (`docs/wire-format/certificates.md`)."""

import re
from dataclasses import dataclass

import cbor2

from .encoding import Refused, compressed, decode, decode_deterministic, encode, is_bytes, load_public
from .signing import is_low, sign, verify

MAX_CERTIFICATE = 4096
SKEW_S = 60
SERIAL_AHEAD_S = 600
U32 = 2**32 - 1
U64 = 2**64 - 1


def name(value) -> bool:
    return is_bytes(value, 32)


def key(value) -> bool:
    if not is_bytes(value, 33):
        return False
    load_public(value)
    return True


def boolean(value) -> bool:
    return isinstance(value, bool)


def number(least: int = 0, most: int = U64):
    return lambda value: type(value) is int and least <= value <= most


def text(pattern: str):
    compiled = re.compile(pattern)
    return lambda value: isinstance(value, str) and compiled.fullmatch(value) is not None


def listed(item, most: int):
    return lambda value: isinstance(value, list) and len(value) <= most and all(map(item, value))


def record(**fields):
    return lambda value: isinstance(value, dict) and set(value) == set(fields) and all(
        check(value[field]) for field, check in fields.items()
    )


def rising(values: list) -> bool:
    return all(a < b for a, b in zip(values, values[1:], strict=False))


ROLE = text("[a-z0-9_-]{1,32}")
LABEL = text("[a-z][a-z0-9_]{0,31}")


def pattern(value) -> bool:
    return isinstance(value, str) and len(value.encode()) <= 253


def grantee(value) -> bool:
    return record(entity=name)(value) or record(role=record(domain=name, role=ROLE))(value)


def socket_address(value) -> bool:
    byte, port = number(0, 255), number(0, 65535)
    for family, length in (("V4", 4), ("V6", 16)):
        if isinstance(value, dict) and set(value) == {family}:
            parts = value[family]
            return (
                isinstance(parts, list) and len(parts) == 2 and isinstance(parts[0], list)
                and len(parts[0]) == length and all(map(byte, parts[0])) and port(parts[1])
            )
    return False


def neighbour(value) -> bool:
    return isinstance(value, list) and len(value) == 2 and name(value[0]) and number(1, U32)(value[1])


def or_null(check):
    return lambda value: value is None or check(value)


TOPICS = listed(record(member=lambda value: value == "*" or LABEL(value), topics=listed(pattern, 64)), 64)
BORDER = record(
    domain=name, switch=name, cost=number(1, U32), transit=boolean, ours_transit=boolean, parent=or_null(number(0, 255))
)
ISSUED = {"serial": number(), "not_before": number(), "not_after": number()}
OPERATIONS = ("publish", "subscribe", "serve", "call", "withdraw")


@dataclass(frozen=True)
class Kind:
    name: str
    content_type: str
    fields: dict
    optional: dict


def kind(title: str, stem: str, fields: dict, optional: dict | None = None, version: int = 2) -> tuple[str, Kind]:
    return title, Kind(title, f"application/vnd.gdp.{stem}.v{version}+cbor", fields, optional or {})


KINDS = dict([
    kind("AdCert", "ad-cert", {"name": name, "entity": name, "scope": listed(name, 64), **ISSUED}),
    kind("ReadGrant", "read-grant", {"name": name, "to": grantee, **ISSUED}),
    kind("Delegation", "delegation", {"name": name, "delegate": key, "publish": boolean, "read": boolean, **ISSUED}),
    kind("Revocation", "revocation",
         {"name": name, "number": number(), "floor": number(), "revoked": listed(number(), 256)}, {"signer": key}),
    kind("MemberCert", "member-cert", {"domain": name, "entity": name, "role": ROLE, **ISSUED}),
    kind("Invite", "invite", {"domain": name, "key": key, "role": ROLE, **ISSUED, "member_until": number()}),
    kind("RenewalDelegation", "renewal-delegation",
         {"domain": name, "member": number(), "key": key, "lifetime": number(1), **ISSUED}, version=1),
    kind("Enrollment", "enrollment",
         {"domain": name, "member": number(), "label": LABEL, "expose": listed(pattern, 64), "import": TOPICS,
          "read": TOPICS, "join_service": key, **ISSUED}, version=1),
    kind("PeerCert", "peer-cert",
         {"domain": name, "peer": name, "rights": record(peering=boolean, transit=boolean, visit=boolean), **ISSUED}),
    kind("RtCert", "rt-cert", {"entity": name, "switch": name, "not_after": number()}),
    kind("Advert", "advert",
         {"op": lambda value: value in OPERATIONS, "name": name, "entity": name, "switch": name, "serial": number(),
          "lifetime": number(0, U32), "box_key": key}),
    kind("SwitchStatement", "switch-statement",
         {"switch": name, "domain": name, "addresses": listed(socket_address, 8), "serial": number(),
          "not_after": number()}),
    kind("LinkState", "link-state",
         {"switch": name, "run": number(), "number": number(), "bit": or_null(number(0, 63)),
          "neighbours": listed(neighbour, 45), "silent": number(), "rib": boolean, "borders": listed(BORDER, 16),
          "lifetime": number(1, 3600)}),
    kind("KeyBox", "key-box",
         {"name": name, "writer": name, "reader": name, "epoch": number(0, U32),
          "sealed": lambda value: is_bytes(value, 113)}),
])


def related(title: str, claims: dict) -> bool:
    """Returns whether the bounds hold that are about several fields."""
    if claims.get("not_before", 0) > claims.get("not_after", U64):
        return False
    match title:
        case "Revocation":
            return rising(claims["revoked"])
        case "Invite":
            return claims["member_until"] >= claims["not_after"]
        case "PeerCert":
            return claims["peer"] != claims["domain"]
        case "LinkState":
            names = [entry[0] for entry in claims["neighbours"]]
            borders = [(border["domain"], border["switch"]) for border in claims["borders"]]
            own = claims["switch"]
            return (
                rising(names) and rising(borders) and own not in names and own not in [b[1] for b in borders]
                and claims["silent"] < 1 << len(names)
            )
        case _:
            return True


def header_of(wanted: Kind, signer: bytes) -> bytes:
    return encode({1: -7, 3: wanted.content_type, 4: signer})


def to_be_signed(wanted: Kind, signer: bytes, payload: bytes) -> bytes:
    return encode(["Signature1", header_of(wanted, signer), wanted.content_type.encode(), payload])


def issue(title: str, claims: dict, signing_key) -> bytes:
    """Returns the bytes of a certificate."""
    wanted, signer, payload = KINDS[title], compressed(signing_key.public_key()), encode(claims)
    signature = sign(signing_key, to_be_signed(wanted, signer, payload))
    return assemble(wanted, signer, payload, signature)


def assemble(wanted: Kind, signer: bytes, payload: bytes, signature: bytes) -> bytes:
    return encode(cbor2.CBORTag(18, [header_of(wanted, signer), {}, payload, signature]))


@dataclass(frozen=True)
class Certificate:
    kind: str
    signer: bytes
    claims: dict


def open_certificate(data, title: str, signer: bytes | None = None, now_ns: int | None = None) -> Certificate:
    """Verifies a certificate by a required signer, or by any if that is None.

    The order of checks is that of the document. The validity is checked at `now_ns` (ns since the
    Unix epoch), unless that is None.
    """
    wanted = KINDS[title]
    if not isinstance(data, bytes) or len(data) > MAX_CERTIFICATE:
        raise Refused("Malformed", f"a {title} has at most {MAX_CERTIFICATE} bytes")
    tagged = decode(data)
    parts = tagged.value if isinstance(tagged, cbor2.CBORTag) and tagged.tag == 18 else None
    if not isinstance(parts, (list, tuple)) or len(parts) != 4:
        raise Refused("Malformed", "no COSE_Sign1")
    protected, _, payload, signature = parts
    if not all(isinstance(part, bytes) for part in (protected, payload)) or not is_bytes(signature, 64):
        raise Refused("Malformed", "no COSE_Sign1")
    header = decode(protected)
    if isinstance(header, dict) and header.get(3) == wanted.content_type.replace(".v2+", ".v1+") != wanted.content_type:
        raise Refused("Unsupported", f"a {title} of the first format")
    if not isinstance(header, dict) or header.get(3) != wanted.content_type:
        raise Refused("Malformed", f"expected a {title}")
    public = load_public(header.get(4))
    claims = check_claims(wanted, decode_deterministic(payload))
    if data != assemble(wanted, header[4], payload, signature):
        raise Refused("Malformed", "other headers or another encoding")
    if signer is not None and header[4] != signer:
        raise Refused("BadSignature", "signed by another key")
    if not is_low(signature):
        raise Refused("BadSignature", "high s")
    verify(public, signature, to_be_signed(wanted, header[4], payload))
    if now_ns is not None:
        check_time(title, claims, now_ns)
    return Certificate(title, header[4], claims)


def check_claims(wanted: Kind, claims) -> dict:
    if not isinstance(claims, dict) or not all(isinstance(field, str) for field in claims):
        raise Refused("Malformed", "the payload is no map of fields")
    known = wanted.fields | wanted.optional
    critical = claims.get("critical", [])
    if not isinstance(critical, list) or not all(isinstance(field, str) for field in critical):
        raise Refused("Malformed", "critical is no list of names")
    if any(field in claims and field not in known for field in critical):
        raise Refused("Unsupported", "an unknown critical field")
    for field, check in known.items():
        if field not in claims and field in wanted.optional:
            continue
        if field not in claims or not check(claims[field]):
            raise Refused("Malformed", f"the field {field}")
    claims = {field: claims[field] for field in known if field in claims}
    if not related(wanted.name, claims):
        raise Refused("Malformed", "a bound")
    return claims


def check_time(title: str, claims: dict, now_ns: int) -> None:
    now = now_ns // 10**9
    if "serial" in claims and title != "Advert" and claims["serial"] > now_ns + SERIAL_AHEAD_S * 10**9:
        raise Refused("NotYetValid", "the serial is of the future")
    if claims.get("not_before", 0) > now + SKEW_S:
        raise Refused("NotYetValid", "it begins later")
    if claims.get("not_after", U64) < now:
        raise Refused("Expired", "it has ended")
