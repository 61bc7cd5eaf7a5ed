"""QUIC with raw public keys and the TLS exporter (`docs/wire-format/links.md`).

aioquic authenticates by X.509 and has no exporter. This module replaces both in its TLS state
machine: certificate types of RFC 7250, a SubjectPublicKeyInfo as certificate, RFC 8446 section 7.5.
"""

import hashlib
import ssl

from aioquic import tls
from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.connection import QuicConnection
from aioquic.quic.packet import QuicProtocolVersion
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_der_public_key

CLIENT_CERTIFICATE_TYPE, SERVER_CERTIFICATE_TYPE, RAW_PUBLIC_KEY = 19, 20, 2
# All versions up to the newest one, also those that are not spoken any more.
ALPN = ["gdp/2", "gdp/1"]
SPOKEN = "gdp/2"
IDLE_S = 4.0


class RawKey:
    """A public key in the role of an X.509 certificate of aioquic."""

    def __init__(self, key: ec.EllipticCurvePublicKey):
        self.key = key

    def public_key(self) -> ec.EllipticCurvePublicKey:
        return self.key

    def public_bytes(self, _encoding) -> bytes:
        return self.key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)


class RawKeyContext(tls.Context):
    """The client's TLS state machine with raw public keys."""

    exporter_secret: bytes | None = None

    def adopt(self, signing_key: ec.EllipticCurvePrivateKey) -> None:
        self._verify_mode = ssl.CERT_NONE
        self._signature_algorithms = [tls.SignatureAlgorithm.ECDSA_SECP256R1_SHA256]
        self.certificate, self.certificate_private_key = RawKey(signing_key.public_key()), signing_key
        offer = bytes([1, RAW_PUBLIC_KEY])
        self.handshake_extensions += [(CLIENT_CERTIFICATE_TYPE, offer), (SERVER_CERTIFICATE_TYPE, offer)]

    def _client_handle_encrypted_extensions(self, input_buf) -> None:
        super()._client_handle_encrypted_extensions(input_buf)
        chosen = dict(self.received_extensions)
        for extension in (CLIENT_CERTIFICATE_TYPE, SERVER_CERTIFICATE_TYPE):
            if chosen.get(extension) != bytes([RAW_PUBLIC_KEY]):
                raise tls.AlertUnsupportedCertificate("the server does not use raw public keys")

    def _set_peer_certificate(self, certificate) -> None:
        spki = certificate.certificates[0][0]
        try:
            key = load_der_public_key(spki)
        except (ValueError, UnsupportedAlgorithm) as error:
            raise tls.AlertBadCertificate("not a public key") from error
        if not isinstance(key, ec.EllipticCurvePublicKey) or not isinstance(key.curve, ec.SECP256R1):
            raise tls.AlertBadCertificate("not a key of P-256")
        if len(certificate.certificates) != 1 or RawKey(key).public_bytes(None) != spki:
            raise tls.AlertBadCertificate("not one uncompressed point")
        self._peer_certificate = RawKey(key)

    def _setup_traffic_protection(self, direction, epoch, label) -> None:
        super()._setup_traffic_protection(direction, epoch, label)
        if label == b"s ap traffic":
            # The transcript ends with the server's Finished here, as the exporter wants it.
            self.exporter_secret = self.key_schedule.derive_secret(b"exp master")

    def export(self, label: bytes, context: bytes, length: int) -> bytes:
        algorithm = self.key_schedule.algorithm
        size, digest = algorithm.digest_size, lambda data: hashlib.new(algorithm.name, data).digest()
        secret = tls.hkdf_expand_label(algorithm, self.exporter_secret, label, digest(b""), size)
        return tls.hkdf_expand_label(algorithm, secret, b"exporter", digest(context), length)

    def peer_key(self) -> ec.EllipticCurvePublicKey:
        return self._peer_certificate.public_key()


class RawKeyConnection(QuicConnection):
    """A client's connection that is authenticated by raw public keys."""

    def __init__(self, signing_key: ec.EllipticCurvePrivateKey):
        super().__init__(configuration=QuicConfiguration(
            is_client=True,
            alpn_protocols=ALPN,
            idle_timeout=IDLE_S,
            verify_mode=ssl.CERT_NONE,
            supported_versions=[QuicProtocolVersion.VERSION_1],
        ))
        self.signing_key = signing_key

    def _initialize(self, peer_cid: bytes) -> None:
        super()._initialize(peer_cid)
        # The context is made inside the method above, which offers no other way to replace it.
        self.tls.__class__ = RawKeyContext
        self.tls.adopt(self.signing_key)
