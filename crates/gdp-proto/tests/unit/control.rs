//! Unit tests of `control`.

use super::*;
use gdp_core::cert::{AdvertOp, Grantee, ReadGrant, issue};
use gdp_core::identity::SigningKey;

#[test]
fn a_push_survives_the_wire() {
    let push = FibPush {
        switch: Name::from_bytes([1; 32]),
        run: 1,
        settling: true,
        generation: 7,
        extent: Extent::Full { part: 0, last: true },
        own_bit: 63,
        set: vec![Route { name: Name::from_bytes([3; 32]), egress_bits: 1 << 63, ..Route::default() }],
        remove: vec![Name::from_bytes([4; 32])],
    };
    let bytes = encode(&Request::Fib(push.clone())).unwrap();
    assert_eq!(decode_length(bytes[..4].try_into().unwrap()).unwrap(), bytes.len() - 4);
    let Request::Fib(decoded) = decode(&bytes[4..]).unwrap() else { panic!("another request") };
    assert_eq!(decoded, push);
}

#[test]
fn the_length_is_bounded_both_ways() {
    let names = vec![Name::default(); MAX_MESSAGE / 32];
    assert!(matches!(encode(&names), Err(CodecError::TooLong(_))));
    assert!(matches!(decode_length([0, 1, 0, 1]), Err(CodecError::TooLong(65537))));
    assert!(matches!(decode_length([0xff; 4]), Err(CodecError::TooLong(_))));
    assert!(decode_length([0, 1, 0, 0]).is_ok());
}

#[test]
fn hostile_bytes_are_refused_without_panic_or_recursion() {
    let bytes = encode(&Response::Done).unwrap();
    let mut longer = bytes[4..].to_vec();
    longer.push(0);
    assert!(decode::<Response>(&longer).is_err(), "trailing bytes");
    for length in 0..bytes.len() - 4 {
        assert!(decode::<Response>(&bytes[4..4 + length]).is_err(), "truncated to {length}");
    }
    assert!(decode::<Request>(&[0x81; MAX_MESSAGE]).is_err(), "nested arrays");
    assert!(decode::<Request>(&[0x9b, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff]).is_err(), "huge array");
    assert!(decode::<Vec<Name>>(&[0x9b, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff]).is_err(), "huge array");
    assert!(decode::<String>(&[0x7b, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff]).is_err(), "huge text");
}

#[test]
fn a_record_is_believed_only_if_all_of_it_fits() {
    let (owner, robot, other) = (key(1), key(2), key(3));
    let card = |owner: &SigningKey, digest| NameProof { owner_key: owner.public(), digest: [digest; 32] };
    let (topic, robot_proof) = (card(&owner, 7), card(&robot, 8));
    let (name, entity, switch) = (topic.name().unwrap(), robot_proof.name().unwrap(), Name::from_bytes([9; 32]));
    let (not_before, not_after, box_key) = (100, 200, robot.public());
    let ad = AdCert { name, entity, scope: vec![], serial: 5, not_before, not_after };
    let grant = ReadGrant { name, to: Grantee::Entity(entity), serial: 5, not_before, not_after };
    let says = Advert { op: AdvertOp::Publish, name, entity, switch, serial: 1, lifetime: 60, box_key };
    let writer = Record {
        name,
        proof: topic,
        entity: robot_proof,
        switch,
        credential: Credential::Writer(issue(&owner, &ad).unwrap().into()),
        advert: issue(&robot, &says).unwrap(),
        expires_in: 60,
    };
    let reader = Record {
        credential: Credential::Reader(issue(&owner, &grant).unwrap().into()),
        advert: issue(&robot, &Advert { op: AdvertOp::Subscribe, ..says.clone() }).unwrap(),
        ..writer.clone()
    };
    for record in [&writer, &reader] {
        let verified = record.verify(None, 150).unwrap();
        assert_eq!((verified.entity, verified.not_after), (entity, 200));
        assert!(matches!(record.verify(None, 39), Err(CertError::NotYetValid { .. })));
        assert!(matches!(record.verify(None, 201), Err(CertError::Expired { .. })));
        let revoked =
            |floor| record.verify(Some(&Revocation { name, number: 1, floor, revoked: vec![], signer: None }), 150);
        assert!(revoked(5).is_ok());
        assert!(matches!(revoked(6), Err(CertError::Revoked { serial: 5, floor: 6, .. })));
        let bytes = encode(record).unwrap();
        assert_eq!(decode::<Record>(&bytes[4..]).unwrap().verify(None, 150), Ok(verified));
    }
    assert!(writer.is_writer() && !reader.is_writer());

    let with = |change: &dyn Fn(&mut Record)| {
        let mut record = writer.clone();
        change(&mut record);
        record.verify(None, 150).unwrap_err()
    };
    let elsewhere = Name::from_bytes([5; 32]);
    let ad_cert = |signer: &SigningKey, ad: AdCert| Credential::Writer(issue(signer, &ad).unwrap().into());
    let advert = |signer: &SigningKey, says: Advert| issue(signer, &says).unwrap();
    for (what, error, expected) in [
        ("name", with(&|r| r.name = elsewhere), "wrong name"),
        ("digest", with(&|r| r.proof.digest[0] ^= 1), "wrong name"),
        ("owner", with(&|r| r.proof.owner_key = other.public()), "wrong name"),
        ("entity", with(&|r| r.entity = card(&other, 8)), "wrong entity"),
        ("entity's digest", with(&|r| r.entity.digest[0] ^= 1), "wrong entity"),
        ("switch", with(&|r| r.switch = elsewhere), "wrong switch"),
        ("certificate of another", with(&|r| r.credential = ad_cert(&other, ad.clone())), "wrong key"),
        (
            "certificate for another name",
            with(&|r| r.credential = ad_cert(&owner, AdCert { name: elsewhere, ..ad.clone() })),
            "wrong name",
        ),
        (
            "certificate for another entity",
            with(&|r| r.credential = ad_cert(&owner, AdCert { entity: elsewhere, ..ad.clone() })),
            "wrong entity",
        ),
        ("statement of another", with(&|r| r.advert = advert(&other, says.clone())), "wrong key"),
        (
            "statement about another name",
            with(&|r| r.advert = advert(&robot, Advert { name: elsewhere, ..says.clone() })),
            "wrong name",
        ),
        (
            "statement of a withdrawal",
            with(&|r| r.advert = advert(&robot, Advert { op: AdvertOp::Withdraw, ..says.clone() })),
            "wrong operation",
        ),
        ("reader as writer", with(&|r| r.advert = reader.advert.clone()), "wrong operation"),
    ] {
        assert!(error.to_string().contains(expected), "{what}: {error}");
    }
}

#[test]
fn a_refusal_always_fits() {
    let refusal = Refusal::new(RefusalCode::Limit, "é".repeat(100_000));
    assert!(encode(&Response::from(refusal)).unwrap().len() < 2048);
}

fn key(seed: u8) -> SigningKey {
    SigningKey::from_secret_bytes(&[seed; 32]).unwrap()
}
