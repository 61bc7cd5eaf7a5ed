"""Chains of certificates, memberships and revocations (`certificates.md`, `domains.md`)."""

from .certificates import Certificate, open_certificate
from .encoding import Refused, metadata_digest, name_of

RENEWAL_GRACE_S = 300
OTHER_KINDS = ("switch", "proxy", "rib", "tool", "owner")


def check_revoked(certificate: Certificate, revocation: dict | None) -> None:
    serial = certificate.claims["serial"]
    if revocation and (serial < revocation["floor"] or serial in revocation["revoked"]):
        raise Refused("Revoked", f"the {certificate.kind} with serial {serial}")


def check_name(certificate: Certificate, name: bytes, field: str = "name") -> None:
    if certificate.claims[field] != name:
        code = "WrongName" if field == "name" else "NotEntitled"
        raise Refused(code, f"the {certificate.kind} is of another {field}")


def exact(value, required: set[str], optional: set[str] = frozenset()) -> None:
    if not isinstance(value, dict) or not required <= set(value) <= required | optional:
        raise Refused("Malformed", f"expected a map of {sorted(required)}")


def open_issued(issued: dict, title: str, name: bytes, owner: bytes, now_ns: int, revoked: dict | None) -> Certificate:
    """Verifies an AdCert or ReadGrant of `name` with the Delegation that it depends on."""
    exact(issued, {"cert", "delegation"})
    signer, delegation = owner, None
    if issued["delegation"] is not None:
        delegation = open_certificate(issued["delegation"], "Delegation", owner, now_ns)
        check_name(delegation, name)
        check_revoked(delegation, revoked)
        if not delegation.claims["publish" if title == "AdCert" else "read"]:
            raise Refused("NotEntitled", f"the delegate may issue no {title}")
        signer = delegation.claims["delegate"]
    certificate = open_certificate(issued["cert"], title, signer, now_ns)
    check_name(certificate, name)
    if delegation and certificate.claims["serial"] < delegation.claims["serial"]:
        raise Refused("NotEntitled", "issued before its delegation")
    check_revoked(certificate, revoked)
    return certificate


def check_writer(issued: dict, name: bytes, owner: bytes, entity: bytes, now_ns: int, revoked: dict | None) -> None:
    certificate = open_issued(issued, "AdCert", name, owner, now_ns, revoked)
    if certificate.claims["entity"] != entity:
        raise Refused("WrongEntity", "the AdCert is of another entity")


def check_reader(
    reading: dict, name: bytes, owner: bytes, entity: bytes, now_ns: int, revoked: dict | None, domain_revoked=None
) -> None:
    exact(reading, {"grant", "member"})
    to = open_issued(reading["grant"], "ReadGrant", name, owner, now_ns, revoked).claims["to"]
    member = reading["member"]
    if "entity" in to:
        if member is not None:
            raise Refused("Malformed", "a membership that is not asked for")
        if to["entity"] != entity:
            raise Refused("WrongEntity", "the ReadGrant is of another entity")
        return
    if member is None:
        raise Refused("NotEntitled", "a membership is missing")
    if member.get("invite") is not None:
        raise Refused("NotEntitled", "a membership by invitation")
    certificate = check_membership(member, to["role"]["domain"], now_ns, domain_revoked)
    if certificate.claims["role"] != to["role"]["role"]:
        raise Refused("NotEntitled", "another role")
    if certificate.claims["entity"] != entity:
        raise Refused("WrongEntity", "the membership is of another entity")


def domain_keys(proof: dict, domain: bytes):
    """Returns a check whether a key may sign for the domain: its own, or its successor's."""
    if name_of(proof) != domain:
        raise Refused("NotEntitled", "the proof is of another domain")
    if proof["digest"] in [metadata_digest({"kind": other}) for other in OTHER_KINDS]:
        raise Refused("NotEntitled", "the name of another entity")

    def check(certificate: Certificate) -> None:
        successor = {"kind": "domain", "successor": certificate.signer.hex()}
        if certificate.signer != proof["owner_key"] and metadata_digest(successor) != proof["digest"]:
            raise Refused("BadSignature", "not signed by the domain")

    return check


def check_membership(member: dict, domain: bytes, now_ns: int, revoked: dict | None) -> Certificate:
    """Returns the MemberCert, which the domain signed or the key of an Invite."""
    exact(member, {"domain", "cert", "invite"}, {"renewal"})
    by_domain = domain_keys(member["domain"], domain)
    # A renewed membership holds although its first certificate may have ended.
    first_now = None if "renewal" in member else now_ns
    certificate = open_certificate(member["cert"], "MemberCert", None, first_now)
    check_name(certificate, domain, "domain")
    if member["invite"] is None:
        by_domain(certificate)
        basis = certificate
    else:
        basis = open_certificate(member["invite"], "Invite")
        by_domain(basis)
        check_invited(certificate, basis, domain)
        check_revoked(basis, revoked)
    check_revoked(certificate, revoked)
    if "renewal" in member:
        check_renewal(member["renewal"], certificate, basis, by_domain, now_ns, revoked)
    return certificate


def check_invited(certificate: Certificate, invite: Certificate, domain: bytes) -> None:
    claims, terms = certificate.claims, invite.claims
    check_name(invite, domain, "domain")
    if certificate.signer != terms["key"]:
        raise Refused("BadSignature", "not signed by the key of the Invite")
    if claims["role"] != terms["role"]:
        raise Refused("NotEntitled", "another role than that of the Invite")
    if claims["serial"] < terms["serial"]:
        raise Refused("NotEntitled", "issued before the Invite")
    if claims["serial"] // 10**9 > terms["not_after"]:
        raise Refused("Expired", "issued after the end of the Invite")
    if claims["not_after"] > terms["member_until"]:
        raise Refused("Malformed", "a membership for longer than the Invite admits")


def check_renewal(renewal: dict, first: Certificate, basis: Certificate, by_domain, now_ns: int, revoked) -> None:
    exact(renewal, {"delegation", "cert"})
    delegation = open_certificate(renewal["delegation"], "RenewalDelegation", None, now_ns)
    by_domain(delegation)
    terms = delegation.claims
    if terms["member"] != basis.claims["serial"] or terms["domain"] != first.claims["domain"]:
        raise Refused("NotEntitled", "the renewal of another membership")
    again = open_certificate(renewal["cert"], "MemberCert", terms["key"], now_ns)
    claims = again.claims
    if any(claims[field] != first.claims[field] for field in ("domain", "entity", "role")):
        raise Refused("WrongEntity", "the renewal differs from the first part")
    if claims["serial"] < terms["serial"]:
        raise Refused("NotEntitled", "issued before its delegation")
    if claims["not_after"] - claims["not_before"] > terms["lifetime"] + RENEWAL_GRACE_S:
        raise Refused("Malformed", "the renewal is longer than delegated")
    check_revoked(delegation, revoked)
    check_revoked(again, revoked)
