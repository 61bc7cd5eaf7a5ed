"""Files of keys, cards and certificates (`certificates.md`, `stored.md`)."""

import base64
import binascii
import json
import re
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from .encoding import Refused, derive_name, metadata_digest

MAX_FILE = 114688
MAX_BLOCK = 8192
MAX_BLOCKS = 7
MAX_CARD = 65536
BLOCK = re.compile(r"-----BEGIN ([A-Z ]+)-----\n([A-Za-z0-9+/=\n]*)-----END \1-----\n?")


def blocks(path: Path, labels: list[str]) -> list[bytes | None]:
    """Returns the block of each label, in the order of the file; a block may be missing."""
    content = path.read_text("ascii")
    if len(content) > MAX_FILE or BLOCK.sub("", content).strip():
        raise Refused("Malformed", f"{path}: not only blocks of certificates")
    found: dict[str, bytes] = {}
    for match in BLOCK.finditer(content):
        label, text = match.groups()
        if label.startswith("GDP OPTIONAL "):
            continue
        if label not in labels[len(found) :] or len(match.group()) > MAX_BLOCK or len(found) == MAX_BLOCKS:
            raise Refused("Malformed", f"{path}: a block {label} is not expected here")
        try:
            found[label] = base64.b64decode(text.replace("\n", ""), validate=True)
        except binascii.Error as error:
            raise Refused("Malformed", f"{path}: {label} is not base64") from error
    return [found.get(label) for label in labels]


def read_key(path: Path) -> tuple[ec.EllipticCurvePrivateKey, str]:
    """Returns the private key of an entity, and the kind that its name has."""
    content = path.read_text("ascii")
    kind = re.search(r"^kind: ([a-z]+)$", content, re.MULTILINE)
    key = load_pem_private_key(content[content.index("-----BEGIN") :].encode(), None)
    if kind is None or not isinstance(key, ec.EllipticCurvePrivateKey):
        raise Refused("Malformed", f"{path}: no key of an entity on P-256")
    return key, kind.group(1)


def read_card(path: Path) -> tuple[bytes, dict]:
    """Returns name and name proof of a card."""
    content = path.read_bytes()
    card = json.loads(content) if len(content) <= MAX_CARD else {}
    if set(card) != {"version", "name", "owner_key", "metadata"} or card["version"] != 1:
        raise Refused("Malformed", f"{path}: no card of version 1")
    proof = {"owner_key": bytes.fromhex(card["owner_key"]), "digest": metadata_digest(card["metadata"])}
    name = derive_name(proof["owner_key"], proof["digest"])
    if name.hex() != card["name"]:
        raise Refused("WrongName", f"{path}: the card has another name than it derives")
    return name, proof


def read_ad(path: Path) -> dict:
    cert, delegation = blocks(path, ["GDP AD CERT", "GDP DELEGATION"])
    return {"cert": cert, "delegation": delegation}


def read_grant(path: Path) -> dict:
    """Returns a right to read by a grant to an entity."""
    cert, delegation = blocks(path, ["GDP READ GRANT", "GDP DELEGATION"])
    return {"grant": {"cert": cert, "delegation": delegation}, "member": None}
