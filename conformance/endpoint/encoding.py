"""CBOR, canonical JSON and names (`docs/wire-format.md`)."""

import hashlib
import io
import json

import cbor2
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

STATEMENT_DEPTH = 16
CONTROL_DEPTH = 24


class Refused(Exception):
    """Something that the document says to refuse, with a code of `control.md`."""

    def __init__(self, code: str, reason: str):
        super().__init__(f"{code}: {reason}")
        self.code = code
        self.reason = reason


def encode(value) -> bytes:
    """Returns deterministic CBOR (RFC 8949, section 4.2.1)."""
    return cbor2.dumps(value, canonical=True)


def decode(data: bytes, depth: int = CONTROL_DEPTH):
    """Decodes any valid CBOR of one value, nested at most `depth` deep."""
    try:
        stream = io.BytesIO(data)
        value = cbor2.CBORDecoder(stream, max_depth=depth, allow_duplicate_keys=False, read_size=1).decode()
    except (cbor2.CBORError, ValueError, TypeError) as error:
        raise Refused("Malformed", f"no CBOR: {error}") from error
    if stream.read(1):
        raise Refused("Malformed", "bytes behind the value")
    return value


def decode_deterministic(data: bytes, depth: int = STATEMENT_DEPTH):
    """Decodes deterministic CBOR, and refuses any other encoding."""
    value = decode(data, depth)
    if encode(value) != data:
        raise Refused("Malformed", "not deterministic CBOR")
    return value


def canonical_json(metadata: dict[str, str]) -> bytes:
    """Returns RFC 8785 of an object whose values are strings."""
    ordered = dict(sorted(metadata.items(), key=lambda item: item[0].encode("utf-16-be")))
    return json.dumps(ordered, ensure_ascii=False, separators=(",", ":")).encode()


def sha256(*parts: bytes) -> bytes:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.digest()


def hkdf(key: bytes, info: bytes, salt: bytes | None = None, length: int = 32) -> bytes:
    return HKDF(hashes.SHA256(), length, salt, info).derive(key)


def metadata_digest(metadata: dict[str, str]) -> bytes:
    return sha256(canonical_json(metadata))


def derive_name(owner_key: bytes, digest: bytes) -> bytes:
    return sha256(b"gdp/name/1", owner_key, digest)


def proof_of(owner_key: bytes, metadata: dict[str, str]) -> dict:
    return {"owner_key": owner_key, "digest": metadata_digest(metadata)}


def name_of(proof: dict) -> bytes:
    """Returns the name that a name proof derives. The proof is hostile."""
    if not isinstance(proof, dict) or set(proof) != {"owner_key", "digest"}:
        raise Refused("Malformed", "not a name proof")
    load_public(proof["owner_key"])
    if not is_bytes(proof["digest"], 32):
        raise Refused("Malformed", "a digest has 32 bytes")
    return derive_name(proof["owner_key"], proof["digest"])


def is_bytes(value, length: int) -> bool:
    return isinstance(value, bytes) and len(value) == length


def compressed(key: ec.EllipticCurvePublicKey) -> bytes:
    return key.public_bytes(Encoding.X962, PublicFormat.CompressedPoint)


def load_public(data) -> ec.EllipticCurvePublicKey:
    if not is_bytes(data, 33):
        raise Refused("Malformed", "a public key has 33 bytes")
    try:
        return ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), data)
    except ValueError as error:
        raise Refused("Malformed", "not a point on P-256") from error


def private_key(scalar: bytes) -> ec.EllipticCurvePrivateKey:
    return ec.derive_private_key(int.from_bytes(scalar), ec.SECP256R1())


def scalar_of(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_numbers().private_value.to_bytes(32)
