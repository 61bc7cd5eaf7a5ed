//! `docs/vectors/kinds.json`: each kind of certificate with its signature, chains and memberships,
//! and what is refused of them. `GDP_WRITE_VECTORS=1 cargo test -p gdp-core --test kinds` writes
//! the file anew. The same bytes are validated against `docs/gdp.cddl`.

mod examples;
#[path = "unit/published_schema.rs"]
mod schema;
#[path = "unit/published_vectors.rs"]
mod vectors;

use coset::TaggedCborSerializable;
use examples::{NOW, Parties, SERIAL, compose, key, sign};
use gdp_core::cbor::{self, Value};
use gdp_core::cert::domain::roles;
use gdp_core::cert::{
    AdCert, Advert, AdvertOp, CertError, Claims, Delegation, Enrollment, Grantee, Invite, Issued, LinkState,
    MemberCert, Membership, PeerCert, ReadGrant, Reading, RenewalDelegation, Revocation, Signed, SwitchStatement,
};
use gdp_core::domain::{Credentials, Enrolling, Token};
use gdp_core::identity::{Identity, SigningKey, VerifyKey};
use gdp_core::keys::KeyBox;
use gdp_core::name::Name;
use gdp_core::revocations::{Origin, SignedRevocation};
use serde_json::{Value as Json, json};

#[test]
fn vectors_of_each_kind_of_certificate() {
    let parties = Parties::new();
    let computed = json!({
        "about": "private keys are 32 bytes of the seed, signatures have nonces of RFC 6979; refused: null if it holds \
            at the time `now`, otherwise what this implementation says",
        "now": NOW,
        "seeds": {
            "owner": 1, "writer": 2, "reader": 3, "switch": 4, "domain": 5, "invited": 6, "delegate": 7, "service": 8,
            "neighbour": 9, "away": 10,
        },
        "kinds": kinds(&parties),
        "refused_kinds": refused_kinds(&parties),
        "chains": chains(&parties),
        "memberships": memberships(&parties),
    });
    vectors::check("kinds.json", &computed);
}

/// Messages hold more than the certificates: what carries them in files and lines.
#[test]
fn files_and_lines_have_the_published_schema() {
    let parties = Parties::new();
    let valid = |rule: &str, bytes: Vec<u8>| schema::check(rule, &bytes).unwrap_or_else(|e| panic!("{rule}: {e}"));
    valid("name-proof", encode(&parties.topic));
    for membership in [
        parties.membership(&parties.reader, "viewer"),
        parties.invited(&parties.member_cert(&parties.reader, "viewer")),
        parties.renewed(&renewed(&parties)),
    ] {
        valid("membership", encode(&membership));
        let peers = vec![sign(parties.domain.key(), &parties.peer_cert())];
        valid("credentials", encode(&Credentials { membership, peers }));
    }
    valid("host", encode(&parties.host()));
    let revocation = sign(&parties.owner, &parties.revocation());
    for origin in [None, Some(Origin { through: parties.switch.name(), by_tool: true })] {
        let entry = SignedRevocation { proof: parties.topic, revocation: revocation.clone(), origin };
        valid("revocation-entry", encode(&entry));
    }
    let line = |full: bool| {
        let invite = sign(parties.domain.key(), &parties.invite());
        let at = "udp://edge.example:31415".parse().unwrap();
        let token =
            Token::new(parties.domain.proof(), invite, key(6), at, full.then(|| parties.switch.name())).unwrap();
        let enrollment = Enrollment { member: SERIAL + 1, ..parties.enrollment() };
        let enrolling = Enrolling {
            enrollment: sign(parties.domain.key(), &enrollment),
            call: sign(&parties.service, &parties.delegation()),
        };
        let token = if full {
            let also = vec!["tls://edge.example:443".parse().unwrap()];
            token.enroll(enrolling).unwrap().also(also).with_successor(Some(key(9).verify_key()))
        } else {
            token
        };
        use base64ct::{Base64UrlUnpadded, Encoding};
        Base64UrlUnpadded::decode_vec(token.to_line().strip_prefix("gdp1").unwrap()).unwrap()
    };
    valid("invitation", line(false));
    valid("invitation", line(true));
}

/// A schema that admits everything would pass the other tests too.
#[test]
fn the_schema_refuses_other_bytes() {
    let parties = Parties::new();
    let refuse = |rule: &str, bytes: &[u8]| assert!(schema::check(rule, bytes).is_err(), "{rule}");
    let good = sign(&parties.owner, &parties.ad_cert());
    schema::check("ad-cert", good.as_bytes()).unwrap();
    refuse("read-grant", good.as_bytes());
    refuse("ad-cert", &good.as_bytes()[..good.as_bytes().len() - 1]);
    let with = |field: &str, value: Value| {
        let Value::Map(mut fields) = Value::serialized(&parties.ad_cert()).unwrap() else { panic!("a map") };
        fields.retain(|(name, _)| name.as_text() != Some(field));
        if value != Value::Null {
            fields.push((field.into(), value));
        }
        compose(&parties.owner, AdCert::CONTEXT, cbor::encode(&Value::Map(fields)).unwrap(), |cose| cose)
    };
    refuse("ad-cert", &with("serial", Value::Null));
    refuse("ad-cert", &with("serial", (-1).into()));
    refuse("ad-cert", &with("entity", Value::Bytes(vec![0; 31])));
    refuse("ad-cert", &with("entity", Value::Text("ab".repeat(32))));
    refuse("ad-cert", &with("scope", Value::Array(vec![Value::Bytes(vec![0; 32]); 65])));
    let untagged = coset::CoseSign1::from_tagged_slice(good.as_bytes()).unwrap();
    refuse("ad-cert", &coset::CborSerializable::to_vec(untagged).unwrap());
}

fn kinds(parties: &Parties) -> Vec<Json> {
    let (owner, domain) = (&parties.owner, parties.domain.key());
    vec![
        kind("ad-cert", owner, &parties.ad_cert()),
        kind("read-grant", owner, &parties.read_grant()),
        kind("read-grant", owner, &parties.role_grant()),
        kind("delegation", owner, &parties.delegation()),
        kind("revocation", owner, &parties.revocation()),
        kind("member-cert", domain, &parties.member_cert(&parties.reader, "viewer")),
        kind("invite", domain, &parties.invite()),
        kind("renewal-delegation", domain, &parties.renewal_delegation()),
        kind("enrollment", domain, &parties.enrollment()),
        kind("peer-cert", domain, &parties.peer_cert()),
        kind("rt-cert", parties.writer.key(), &parties.rt_cert()),
        kind("advert", parties.writer.key(), &parties.advert(&parties.writer, AdvertOp::Publish)),
        kind("switch-statement", parties.switch.key(), &parties.switch_statement()),
        kind("link-state", parties.switch.key(), &parties.link_state()),
        kind("key-box", parties.writer.key(), &parties.key_box()),
    ]
}

fn kind<T: Claims>(rule: &str, signer: &SigningKey, claims: &T) -> Json {
    let signed = sign(signer, claims);
    signed.verify(&signer.verify_key(), NOW).unwrap_or_else(|error| panic!("{rule}: {error}"));
    schema::check(rule, signed.as_bytes()).unwrap_or_else(|error| panic!("{rule}: {error}"));
    let cose = coset::CoseSign1::from_tagged_slice(signed.as_bytes()).unwrap();
    json!({
        "kind": T::KIND,
        "label": T::LABEL,
        "content_type": T::CONTEXT,
        "signer": signer.verify_key(),
        "claims": claims,
        "payload": hex::encode(cose.payload.as_ref().unwrap()),
        "to_be_signed": hex::encode(cose.tbs_data(T::CONTEXT.as_bytes())),
        "signature": hex::encode(&cose.signature),
        "bytes": hex::encode(signed.as_bytes()),
    })
}

/// One certificate by itself, and why it is refused.
fn refused_kinds(parties: &Parties) -> Vec<Json> {
    let (owner, domain, switch) = (&parties.owner, parties.domain.key(), parties.switch.key());
    let writer = parties.writer.key();
    let (ad, link) = (parties.ad_cert(), parties.link_state());
    let name = |byte| Name::from_bytes([byte; 32]);
    let bounds = |number, revoked| Revocation { number, revoked, ..parties.revocation() };
    let payload = || cbor::encode(&ad).unwrap();
    let composed =
        |change: fn(coset::CoseSign1) -> coset::CoseSign1| compose(owner, AdCert::CONTEXT, payload(), change);
    let mut trailing = sign(owner, &ad).as_bytes().to_vec();
    trailing.push(0);
    let unprotected = |mut cose: coset::CoseSign1| {
        cose.unprotected.key_id = vec![1];
        cose
    };
    let flipped = |mut cose: coset::CoseSign1| {
        cose.signature[0] ^= 1;
        cose
    };
    let by_name = parties.advert(&parties.writer, AdvertOp::Publish);
    vec![
        refused("another kind than expected", owner, sign::<AdCert>(owner, &ad).as_bytes(), reading_as::<ReadGrant>),
        refused("another signer than required", domain, sign(owner, &ad).as_bytes(), reading_as::<AdCert>),
        refused("a changed signature", owner, &composed(flipped), reading_as::<AdCert>),
        refused("an unprotected header", owner, &composed(unprotected), reading_as::<AdCert>),
        refused("a byte behind the certificate", owner, &trailing, reading_as::<AdCert>),
        bad("it has ended", owner, &AdCert { not_after: NOW - 1, not_before: 0, ..ad.clone() }),
        bad("it begins more than 60 s later", owner, &AdCert { not_before: NOW + 61, ..ad.clone() }),
        bad("a serial of the future", owner, &AdCert { serial: (NOW + 601) * 1_000_000_000, ..ad.clone() }),
        bad("it ends before it begins", owner, &AdCert { not_before: NOW, not_after: NOW - 1, ..ad.clone() }),
        bad("a scope of 65 domains", owner, &AdCert { scope: vec![name(7); 65], ..ad.clone() }),
        bad("serials out of order", owner, &bounds(1, vec![3, 2])),
        bad("257 serials", owner, &bounds(1, (0..257).collect())),
        bad(
            "a role with a capital letter",
            owner,
            &ReadGrant {
                to: Grantee::Role { domain: parties.domain.name(), role: "Viewer".into() },
                ..parties.read_grant()
            },
        ),
        bad("a role of 33 characters", domain, &parties.member_cert(&parties.reader, &"v".repeat(33))),
        bad("whom it admits ends before it", domain, &Invite { member_until: NOW, ..parties.invite() }),
        bad("a lifetime of 0 s", domain, &RenewalDelegation { lifetime: 0, ..parties.renewal_delegation() }),
        bad("a domain as its own peer", domain, &PeerCert { peer: parties.domain.name(), ..parties.peer_cert() }),
        bad("a label that begins with a digit", domain, &Enrollment { label: "7robot".into(), ..parties.enrollment() }),
        bad("65 patterns", domain, &Enrollment { expose: vec!["/a".into(); 65], ..parties.enrollment() }),
        bad("a box key that is no point", writer, &Advert { box_key: [5; 33], ..by_name }),
        bad(
            "9 addresses",
            switch,
            &SwitchStatement { addresses: vec!["192.0.2.1:1".parse().unwrap(); 9], ..parties.switch_statement() },
        ),
        bad("a sealed key of 112 bytes", writer, &KeyBox { sealed: vec![0; 112], ..parties.key_box() }),
        bad(
            "neighbours out of order",
            switch,
            &LinkState { neighbours: vec![(name(2), 1), (name(1), 1)], silent: 0, ..link.clone() },
        ),
        bad("a neighbour of cost 0", switch, &LinkState { neighbours: vec![(name(1), 0)], silent: 0, ..link.clone() }),
        bad("silent without a neighbour", switch, &LinkState { silent: 2, ..link.clone() }),
        bad("egress bit 64", switch, &LinkState { bit: Some(64), ..link.clone() }),
        bad("a lifetime of 3601 s", switch, &LinkState { lifetime: 3601, ..link }),
    ]
}

fn bad<T: Claims>(description: &str, signer: &SigningKey, claims: &T) -> Json {
    refused(description, signer, sign(signer, claims).as_bytes(), reading_as::<T>)
}

/// Kind of a certificate, and why it is refused with this signer.
type Refusal = (&'static str, CertError);

fn reading_as<T: Claims>(bytes: &[u8], signer: &VerifyKey) -> Refusal {
    let refused = Signed::<T>::from_bytes(bytes.to_vec()).unwrap().verify(signer, NOW).map(drop);
    (T::KIND, refused.expect_err("it is refused"))
}

fn refused(
    description: &str,
    signer: &SigningKey,
    bytes: &[u8],
    read: impl FnOnce(&[u8], &VerifyKey) -> Refusal,
) -> Json {
    let (kind, error) = read(bytes, &signer.verify_key());
    json!({
        "description": description,
        "expected_kind": kind,
        "required_signer": signer.verify_key(),
        "bytes": hex::encode(bytes),
        "refused": error.to_string(),
    })
}

/// Chains of writers and readers of the topic.
fn chains(parties: &Parties) -> Vec<Json> {
    let (owner, delegate) = (&parties.owner, &parties.delegate);
    let ad = parties.ad_cert();
    let issued = |cert, delegation: Option<&Delegation>| Issued {
        cert,
        delegation: delegation.map(|delegation| sign(owner, delegation)),
    };
    let delegation = parties.delegation();
    let reading = |grant: ReadGrant, member: Option<Membership>| Reading {
        grant: Issued::from(sign(owner, &grant)),
        member: member.map(Box::new),
    };
    let viewer = |role| Some(parties.membership(&parties.reader, role));
    let invited = Some(parties.invited(&parties.member_cert(&parties.reader, "viewer")));
    let late = Delegation { serial: SERIAL + 3, ..delegation.clone() };
    let no_publish = Delegation { publish: false, ..delegation.clone() };
    let elsewhere = Delegation { name: parties.writer.name(), ..delegation.clone() };
    let floor = Revocation { floor: SERIAL + 3, revoked: vec![], ..parties.revocation() };
    let listed = Revocation { revoked: vec![SERIAL + 2], ..parties.revocation() };
    let by = |key, claims| sign::<AdCert>(key, claims);
    let writes = |description, chain: Issued<AdCert>, revocation: Option<&Revocation>| {
        let result = chain.verify_for(&parties.topic, parties.writer.name(), revocation, NOW);
        chain_vector(description, &chain, &parties.writer, revocation, result.err())
    };
    let reads = |description, chain: Reading| {
        let result = chain.verify(&parties.topic, parties.reader.name(), None, NOW);
        chain_vector(description, &chain, &parties.reader, None, result.err())
    };
    let other = AdCert { entity: parties.reader.name(), ..ad.clone() };
    vec![
        writes("by the owner", issued(by(owner, &ad), None), None),
        writes("by a delegate", issued(by(delegate, &ad), Some(&delegation)), None),
        writes("under a revocation of others", issued(by(owner, &ad), None), Some(&parties.revocation())),
        writes("by a delegate, without the delegation", issued(by(delegate, &ad), None), None),
        writes("a delegation without this right", issued(by(delegate, &ad), Some(&no_publish)), None),
        writes("issued before its delegation", issued(by(delegate, &ad), Some(&late)), None),
        writes("a delegation of another name", issued(by(delegate, &ad), Some(&elsewhere)), None),
        writes("for another entity", issued(by(owner, &other), None), None),
        writes("below the floor", issued(by(owner, &ad), None), Some(&floor)),
        writes("a listed serial", issued(by(owner, &ad), None), Some(&listed)),
        reads("a grant to the entity", reading(parties.read_grant(), None)),
        reads("a grant to a role of the reader", reading(parties.role_grant(), viewer("viewer"))),
        reads("a grant to a role, without a membership", reading(parties.role_grant(), None)),
        reads("a grant to another role", reading(parties.role_grant(), viewer(roles::SWITCH))),
        reads("a grant to a role, by invitation", reading(parties.role_grant(), invited)),
        reads("a membership that is not asked for", reading(parties.read_grant(), viewer("viewer"))),
    ]
}

fn chain_vector<T: serde::Serialize>(
    description: &str,
    chain: &T,
    entity: &Identity,
    revocation: Option<&Revocation>,
    refused: Option<CertError>,
) -> Json {
    json!({
        "description": description,
        "entity": entity.name(),
        "chain": chain,
        "revocation": revocation,
        "refused": refused.map(|error| error.to_string()),
    })
}

/// Memberships of the domain.
fn memberships(parties: &Parties) -> Vec<Json> {
    let claims = || parties.member_cert(&parties.reader, "viewer");
    let vector = |description: &str, membership: Membership, revocation: Option<&Revocation>| {
        let result = membership.verify(parties.domain.name(), revocation, NOW);
        json!({
            "description": description,
            "membership": membership,
            "revocation": revocation,
            "refused": result.err().map(|error| error.to_string()),
        })
    };
    let revoked = |floor| Revocation { name: parties.domain.name(), floor, revoked: vec![], ..parties.revocation() };
    let late = MemberCert { serial: (NOW + 61) * 1_000_000_000, ..claims() };
    let long = MemberCert { not_after: claims().not_after + 1, ..claims() };
    let foreign = Membership { domain: parties.away.proof(), ..parties.membership(&parties.reader, "viewer") };
    let too_long = MemberCert { not_after: NOW + 7501, ..renewed(parties) };
    vec![
        vector("by the domain", parties.membership(&parties.reader, "viewer"), None),
        vector("by invitation", parties.invited(&claims()), None),
        vector("renewed", parties.renewed(&renewed(parties)), None),
        vector("with the proof of another domain", foreign, None),
        vector(
            "by invitation, in another role",
            parties.invited(&parties.member_cert(&parties.reader, "switch")),
            None,
        ),
        vector("by invitation, issued after its end", parties.invited(&late), None),
        vector("by invitation, issued before it", parties.invited(&MemberCert { serial: SERIAL, ..claims() }), None),
        vector("by invitation, for longer than it admits", parties.invited(&long), None),
        vector("renewed for longer than delegated", parties.renewed(&too_long), None),
        vector("the invitation is revoked", parties.invited(&claims()), Some(&revoked(SERIAL + 2))),
    ]
}

fn encode<T: serde::Serialize>(value: &T) -> Vec<u8> {
    cbor::encode(value).unwrap()
}

fn renewed(parties: &Parties) -> MemberCert {
    let serial = SERIAL + 6;
    MemberCert { serial, not_after: NOW + 7200, ..parties.member_cert(&parties.reader, "viewer") }
}
