"""Vectors of names, certificates, chains and control messages."""

import pytest

from endpoint import chains, control
from endpoint.certificates import KINDS, assemble, check_time, header_of, issue, open_certificate, to_be_signed
from endpoint.encoding import (
    Refused, canonical_json, compressed, decode, derive_name, encode, metadata_digest, name_of, private_key,
)

# How a reason begins, and the code that the document has for it.
CODES = {
    "malformed certificate": "Malformed",
    "format version 1": "Unsupported",
    "unknown critical field": "Unsupported",
    "wrong key": "BadSignature",
    "bad signature": "BadSignature",
    "high s": "BadSignature",
    "wrong name": "WrongName",
    "wrong domain": "NotEntitled",
    "wrong entity": "WrongEntity",
    "wrong role": "NotEntitled",
    "not delegated": "NotEntitled",
    "not shown to be a member": "NotEntitled",
    "admitted by invitation": "NotEntitled",
    "revoked": "Revoked",
    "issued before its delegation": "NotEntitled",
    "expired": "Expired",
    "not yet valid": "NotYetValid",
    "issued later": "NotYetValid",
}


def unhex(value):
    """Returns bytes for all text of hexadecimal digits."""
    if isinstance(value, dict):
        return {key: unhex(item) for key, item in value.items()}
    if isinstance(value, list):
        return [unhex(item) for item in value]
    return bytes.fromhex(value) if isinstance(value, str) else value


def outcome(refused: str | None) -> str | None:
    return refused and next(code for begin, code in CODES.items() if refused.startswith(begin))


def code_of(action) -> str | None:
    try:
        action()
    except Refused as refused:
        return refused.code
    return None


def seeded(seed: int):
    return private_key(bytes([seed]) * 32)


def test_names(vectors):
    for vector in vectors("name")["vectors"]:
        assert canonical_json(vector["metadata"]).decode() == vector["canonical_json"], vector["description"]
        digest = metadata_digest(vector["metadata"])
        assert digest.hex() == vector["inner_digest"]
        assert derive_name(bytes.fromhex(vector["owner_key"]), digest).hex() == vector["name"]


def test_certificates(vectors):
    cert = vectors("cert")
    owner, now = bytes.fromhex(cert["owner_key"]), cert["now"] * 10**9
    assert issue("AdCert", unhex(cert["claims"]), seeded(1)).hex() == cert["vectors"][0]["bytes"]
    for vector in [*cert["vectors"], {**cert["high_s"], "description": "high s"}]:
        found = code_of(lambda v=vector: open_certificate(bytes.fromhex(v["bytes"]), "AdCert", owner, now))
        assert found == outcome(vector["refused"]), vector["description"]


def test_kinds(vectors):
    kinds = vectors("kinds")
    seeds = {compressed(seeded(seed).public_key()): seed for seed in kinds["seeds"].values()}
    for vector in kinds["kinds"]:
        signer, payload, kind = bytes.fromhex(vector["signer"]), bytes.fromhex(vector["payload"]), KINDS[vector["kind"]]
        data = bytes.fromhex(vector["bytes"])
        assert kind.content_type == vector["content_type"]
        assert to_be_signed(kind, signer, payload).hex() == vector["to_be_signed"]
        assert assemble(kind, signer, payload, bytes.fromhex(vector["signature"])) == data
        opened = open_certificate(data, vector["kind"], signer, kinds["now"] * 10**9)
        assert encode(opened.claims) == payload
        assert issue(vector["kind"], opened.claims, seeded(seeds[signer])) == data


def test_refused_kinds(vectors):
    kinds = vectors("kinds")
    for vector in kinds["refused_kinds"]:
        data, signer = bytes.fromhex(vector["bytes"]), bytes.fromhex(vector["required_signer"])
        found = code_of(lambda: open_certificate(data, vector["expected_kind"], signer, kinds["now"] * 10**9))
        assert found == outcome(vector["refused"]), vector["description"]


def test_chains(vectors):
    kinds = vectors("kinds")
    owner, name = compressed(seeded(1).public_key()), unhex(kinds["kinds"][0]["claims"]["name"])
    for vector in kinds["chains"]:
        revocation, entity, chain = unhex(vector["revocation"]), unhex(vector["entity"]), unhex(vector["chain"])
        check = chains.check_reader if "grant" in chain else chains.check_writer
        found = code_of(lambda: check(chain, name, owner, entity, kinds["now"] * 10**9, revocation))
        assert found == outcome(vector["refused"]), vector["description"]


def test_memberships(vectors):
    kinds = vectors("kinds")
    domain = unhex(next(v for v in kinds["kinds"] if v["kind"] == "MemberCert")["claims"]["domain"])
    for vector in kinds["memberships"]:
        member, revocation = unhex(vector["membership"]), unhex(vector["revocation"])
        found = code_of(lambda: chains.check_membership(member, domain, kinds["now"] * 10**9, revocation))
        assert found == outcome(vector["refused"]), vector["description"]


@pytest.mark.parametrize("kind", ["invite", "member_cert", "peer_cert", "revocation"])
def test_statements_of_a_domain(vectors, kind):
    domain = vectors("domain")
    vector, signer = domain[kind], bytes.fromhex(domain["domain_key"])
    title = "".join(word.capitalize() for word in kind.split("_"))
    payload = bytes.fromhex(vector["payload"])
    assert to_be_signed(KINDS[title], signer, payload).hex() == vector["to_be_signed"]
    assert header_of(KINDS[title], signer) in bytes.fromhex(vector["to_be_signed"])
    check_time(title, decode(payload), 1800000000 * 10**9)


def test_requests(vectors):
    for vector in vectors("control")["requests"]:
        title, _ = control.parse_request(control.open_stream(bytes.fromhex(vector["bytes"])))
        assert title == vector["kinds"][0]


def test_responses(vectors):
    for vector in vectors("control")["responses"]:
        title, data = control.parse_response(control.open_stream(bytes.fromhex(vector["bytes"])))
        assert title == vector["kinds"][0]
        if title == "Records":
            assert len(data["records"]) == 2 and all(len(name_of(r["proof"])) == 32 for r in data["records"])


def test_refused_messages(vectors):
    for vector in vectors("control")["refused"]:
        body = bytes(vector["length"]) if vector["bytes"] == "zeros" else bytes.fromhex(vector["bytes"])
        assert code_of(lambda b=body: control.parse_request(b)) == vector["code"], vector["description"]
