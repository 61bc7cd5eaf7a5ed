"""Content keys: key agreement, wrapped keys and the keys of feedback (`segments.md`)."""

import hmac

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.hkdf import HKDFExpand
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from .encoding import Refused, compressed, hkdf, load_public, private_key, scalar_of
from .signing import ORDER

# RFC 9180: DHKEM(P-256, HKDF-SHA256), HKDF-SHA256, AES-256-GCM.
KEM = (0x0010).to_bytes(2)
SUITE = b"HPKE" + KEM + (0x0001).to_bytes(2) + (0x0002).to_bytes(2)


def box_key(signing_key: ec.EllipticCurvePrivateKey) -> ec.EllipticCurvePrivateKey:
    """Returns the key-agreement key of an entity."""
    for attempt in range(256):
        scalar = hkdf(scalar_of(signing_key), b"gdp/box-key/1" + bytes([attempt]))
        if 0 < int.from_bytes(scalar) < ORDER:
            return private_key(scalar)
    raise AssertionError("no key in 256 attempts")


def box_public(signing_key: ec.EllipticCurvePrivateKey) -> bytes:
    return compressed(box_key(signing_key).public_key())


def uncompressed(key: ec.EllipticCurvePublicKey) -> bytes:
    return key.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)


def extract(suite: bytes, salt: bytes, label: bytes, key: bytes) -> bytes:
    return hmac.digest(salt or bytes(32), b"HPKE-v1" + suite + label + key, "sha256")


def expand(suite: bytes, secret: bytes, label: bytes, info: bytes, length: int) -> bytes:
    labelled = length.to_bytes(2) + b"HPKE-v1" + suite + label + info
    return HKDFExpand(hashes.SHA256(), length, labelled).derive(secret)


def hpke(shared: bytes, encapsulated: bytes, reader: ec.EllipticCurvePublicKey, info: bytes) -> tuple[AESGCM, bytes]:
    """Returns cipher and nonce of the only message of a context in base mode."""
    kem = b"KEM" + KEM
    secret = extract(kem, b"", b"eae_prk", shared)
    secret = expand(kem, secret, b"shared_secret", encapsulated + uncompressed(reader), 32)
    context = b"\0" + extract(SUITE, b"", b"psk_id_hash", b"") + extract(SUITE, b"", b"info_hash", info)
    secret = extract(SUITE, secret, b"secret", b"")
    return AESGCM(expand(SUITE, secret, b"key", context, 32)), expand(SUITE, secret, b"base_nonce", context, 12)


def wrap_info(name: bytes, writer: bytes, reader: bytes, epoch: int) -> bytes:
    return b"gdp/key-box/1" + name + writer + reader + epoch.to_bytes(4)


def wrap(epoch_key: bytes, reader_box: bytes, info: bytes) -> bytes:
    """Returns the epoch key under HPKE, 113 bytes."""
    ephemeral, reader = ec.generate_private_key(ec.SECP256R1()), load_public(reader_box)
    encapsulated = uncompressed(ephemeral.public_key())
    cipher, nonce = hpke(ephemeral.exchange(ec.ECDH(), reader), encapsulated, reader, info)
    return encapsulated + cipher.encrypt(nonce, epoch_key, b"")


def unwrap(sealed: bytes, own: ec.EllipticCurvePrivateKey, info: bytes) -> bytes:
    encapsulated = sealed[:65]
    try:
        ephemeral = ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), encapsulated)
        cipher, nonce = hpke(own.exchange(ec.ECDH(), ephemeral), encapsulated, own.public_key(), info)
        return cipher.decrypt(nonce, sealed[65:], b"")
    except (ValueError, InvalidTag) as error:
        raise Refused("Malformed", "the wrapped key does not open") from error


def pair_key(own: ec.EllipticCurvePrivateKey, own_name: bytes, peer_box: bytes, peer_name: bytes) -> bytes:
    shared = own.exchange(ec.ECDH(), load_public(peer_box))
    return hkdf(shared, b"gdp/pair/1" + min(own_name, peer_name) + max(own_name, peer_name))


def pair_cipher(pair: bytes, session: bytes, sender: bytes, receiver: bytes) -> AESGCM:
    return AESGCM(hkdf(pair, b"gdp/pair-session/1" + sender + receiver, session))
