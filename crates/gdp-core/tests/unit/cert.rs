//! What must be refused, each with the error that says which.

use super::*;
use crate::identity::{Identity, SigningKey};
use crate::name;
use crate::name::{Name, NameProof};

const NOW: u64 = 1_800_000_000;

#[test]
fn a_rightful_publisher_and_subscriber_pass() {
    let f = Fixture::new();
    let (cert, advert) =
        authorise_advertise(&f.speaker, &f.proof, &f.ad_cert(|_| ()).into(), &f.advert(|_| ()), None).unwrap();
    assert_eq!((cert.name, advert.serial), (f.name, 11));
    let subscribe = f.advert(|a| a.op = AdvertOp::Subscribe);
    authorise_subscribe(&f.speaker, &f.proof, &f.grant(|_| ()).into(), &subscribe, None).unwrap();
    authorise_withdraw(&f.speaker, &f.advert(|a| a.op = AdvertOp::Withdraw)).unwrap();
    let (serve, call) = (f.advert(|a| a.op = AdvertOp::Serve), f.advert(|a| a.op = AdvertOp::Call));
    authorise_advertise(&f.speaker, &f.proof, &f.ad_cert(|_| ()).into(), &serve, None).unwrap();
    authorise_subscribe(&f.speaker, &f.proof, &f.grant(|_| ()).into(), &call, None).unwrap();
    let error = authorise_advertise(&f.speaker, &f.proof, &f.ad_cert(|_| ()).into(), &call, None).unwrap_err();
    assert_eq!(error, CertError::WrongOperation { expected: "publish or serve", got: AdvertOp::Call });
}

#[test]
fn each_way_to_be_wrong_has_its_error() {
    let f = Fixture::new();
    let stranger = Name::from_bytes([9; 32]);
    let publish = |cert: &Signed<AdCert>, advert: &Signed<Advert>| {
        authorise_advertise(&f.speaker, &f.proof, &cert.clone().into(), advert, None).unwrap_err()
    };
    let (cert, advert) = (f.ad_cert(|_| ()), f.advert(|_| ()));

    let by_other = issue(&SigningKey::from_secret_bytes(&[3; 32]).unwrap(), &f.ad_cert_claims()).unwrap();
    assert!(matches!(publish(&by_other, &advert), CertError::WrongKey { what: "AdCert", .. }));
    let by_other = issue(&SigningKey::from_secret_bytes(&[3; 32]).unwrap(), &f.advert_claims()).unwrap();
    assert!(matches!(publish(&cert, &by_other), CertError::WrongKey { what: "Advert", .. }));

    let wrong_digest = NameProof { digest: [1; 32], ..f.proof };
    let error = authorise_advertise(&f.speaker, &wrong_digest, &cert.clone().into(), &advert, None).unwrap_err();
    assert!(matches!(error, CertError::WrongName { .. }), "{error}");
    assert!(error.to_string().contains("digest"), "{error}");

    let expired = f.ad_cert(|c| c.not_after = NOW - 1);
    assert_eq!(publish(&expired, &advert), CertError::Expired { at: NOW - 1, now: NOW });
    let from = NOW + CLOCKS_DIFFER + 1;
    let early = f.ad_cert(|c| (c.not_before, c.not_after) = (from, from));
    assert_eq!(publish(&early, &advert), CertError::NotYetValid { from, now: NOW });
    let edge = f.ad_cert(|c| (c.not_before, c.not_after) = (NOW, NOW));
    authorise_advertise(&f.speaker, &f.proof, &edge.into(), &advert, None).unwrap();

    assert!(matches!(publish(&f.ad_cert(|c| c.entity = stranger), &advert), CertError::WrongEntity { .. }));
    assert!(matches!(publish(&f.ad_cert(|c| c.name = stranger), &advert), CertError::WrongName { .. }));
    assert!(matches!(publish(&cert, &f.advert(|a| a.entity = stranger)), CertError::WrongEntity { .. }));
    assert!(matches!(publish(&cert, &f.advert(|a| a.name = stranger)), CertError::WrongName { .. }));
    assert!(matches!(publish(&cert, &f.advert(|a| a.switch = stranger)), CertError::WrongSwitch { .. }));
    assert!(matches!(publish(&cert, &f.advert(|a| a.op = AdvertOp::Subscribe)), CertError::WrongOperation { .. }));
    for serial in [0, 9, 10] {
        let error = publish(&cert, &f.advert(|a| a.serial = serial));
        assert_eq!(error, CertError::ReplayedSerial { got: serial, floor: 10 });
        assert!(error.to_string().starts_with("replayed serial"), "{error}");
    }
}

#[test]
fn no_changed_bit_verifies() {
    let f = Fixture::new();
    let cert = f.ad_cert(|c| c.scope = vec![Name::from_bytes([5; 32])]);
    let key = f.owner.verify_key();
    cert.verify(&key, NOW).unwrap();
    for bit in 0..cert.as_bytes().len() * 8 {
        let mut bytes = cert.as_bytes().to_vec();
        bytes[bit / 8] ^= 1 << (bit % 8);
        let changed = Signed::<AdCert>::from_bytes(bytes).unwrap();
        assert!(changed.verify(&key, NOW).is_err(), "bit {bit}");
    }
    for len in 0..cert.as_bytes().len() {
        let cut = Signed::<AdCert>::from_bytes(cert.as_bytes()[..len].to_vec()).unwrap();
        assert!(cut.verify(&key, NOW).is_err(), "cut to {len}");
    }
    let mut longer = cert.as_bytes().to_vec();
    longer.push(0);
    assert!(Signed::<AdCert>::from_bytes(longer).unwrap().verify(&key, NOW).is_err());
}

/// Anybody can make the other form of a signature. With it, a certificate would have two encodings.
#[test]
fn a_signature_has_one_form() {
    let f = Fixture::new();
    let cert = f.ad_cert(|_| ());
    let (signed, signature) = cert.as_bytes().split_last_chunk().unwrap();
    let restated = [signed, &crate::crypto::tests::restated(signature)].concat();
    let restated = Signed::<AdCert>::from_bytes(restated).unwrap();
    assert_eq!(restated.verify(&f.owner.verify_key(), NOW), Err(CertError::HighS { what: "AdCert" }));
}

/// A ReadGrant whose claims are those of an RtCert would be one if the kind were not signed.
#[test]
fn one_kind_never_verifies_as_another() {
    let f = Fixture::new();
    let key = f.owner.verify_key();
    let grant = f.grant(|_| ());
    let as_ad_cert = Signed::<AdCert>::from_bytes(grant.as_bytes().to_vec()).unwrap();
    let error = as_ad_cert.verify(&key, NOW).unwrap_err();
    assert!(error.to_string().contains("expected AdCert"), "{error}");

    // The same claims under another context: the content type can be exchanged by anybody, the
    // signature not.
    #[derive(serde::Serialize, serde::Deserialize)]
    #[serde(transparent)]
    struct Other(ReadGrant);
    impl Claims for Other {
        const KIND: &'static str = "Other";
        const LABEL: &'static str = "OTHER";
        const CONTEXT: &'static str = "application/vnd.gdp.readXgrant.v2+cbor";
        fn validity(&self) -> Validity {
            self.0.validity()
        }
    }
    let other = issue(&f.owner, &Other(f.grant_claims())).unwrap();
    let find = b"readXgrant";
    let at = other.as_bytes().windows(find.len()).position(|w| w == find).unwrap();
    let mut bytes = other.as_bytes().to_vec();
    bytes[at + 4] = b'-';
    let disguised = Signed::<ReadGrant>::from_bytes(bytes).unwrap();
    assert_eq!(disguised.claims_unverified().unwrap(), f.grant_claims());
    assert_eq!(disguised.verify(&key, NOW), Err(CertError::BadSignature { what: "ReadGrant" }));
}

/// As another implementation would check it: by RFC 9052, with the content type as external data.
#[test]
fn a_certificate_is_plain_cose() {
    use coset::TaggedCborSerializable;
    let f = Fixture::new();
    let cose = coset::CoseSign1::from_tagged_slice(f.ad_cert(|_| ()).as_bytes()).unwrap();
    let check = |aad: &[u8]| {
        cose.verify_signature(aad, |signature, message| {
            f.owner.verify_key().verify(message, signature.try_into().unwrap())
        })
    };
    assert_eq!(check(b"application/vnd.gdp.ad-cert.v2+cbor"), Ok(()));
    assert!(check(b"").is_err());
}

#[test]
fn text_and_cbor_forms_keep_the_bytes() {
    let f = Fixture::new();
    let cert = f.ad_cert(|_| ());
    let text = cert.to_pem();
    assert!(text.starts_with("-----BEGIN GDP AD CERT-----\n"), "{text}");
    assert_eq!(Signed::from_pem(&text), Ok(cert.clone()));
    assert!(Signed::<ReadGrant>::from_pem(&text).unwrap_err().to_string().contains("GDP READ GRANT"));
    for broken in ["", "x", &text[..text.len() / 2], &text.replacen('A', "B", 20), &"A".repeat(100_000)] {
        let error = Signed::<AdCert>::from_pem(broken).unwrap_err().to_string();
        for internal in ["PEM", "Base64", "Semantic", "Syntax", "None", "Io(", "CBOR failure"] {
            assert!(!error.contains(internal), "{error}");
        }
    }
    let blocks = Issued::<AdCert>::from_pem(&f.grant(|_| ()).to_pem()).unwrap_err().to_string();
    let expected = "a grant to read (GDP READ GRANT), where a certificate to publish (GDP AD CERT) is expected";
    assert!(blocks.ends_with(expected), "{blocks}");

    let bytes = crate::cbor::encode(&cert).unwrap();
    assert_eq!(crate::cbor::decode::<Signed<AdCert>>(&bytes, 8192), Ok(cert));
    let too_long = crate::cbor::encode(&serde_json::Value::Null).unwrap();
    assert!(crate::cbor::decode::<Signed<AdCert>>(&too_long, 8192).is_err());
    assert!(Signed::<AdCert>::from_bytes(vec![0; MAX_SIGNED + 1]).is_err());
}

#[test]
fn what_makes_no_sense_is_neither_issued_nor_believed() {
    let f = Fixture::new();
    let mut claims = f.ad_cert_claims();
    claims.scope = vec![f.name; MAX_SCOPE];
    let largest = issue(&f.owner, &claims).unwrap();
    assert!(largest.as_bytes().len() < MAX_SIGNED);
    claims.scope.push(f.name);
    assert!(issue(&f.owner, &claims).is_err());
    let mut claims = f.grant_claims();
    claims.not_before = claims.not_after + 1;
    assert!(issue(&f.owner, &claims).is_err());
    let mut claims = f.advert_claims();
    claims.box_key = [0xff; 33];
    assert!(issue(f.entity.key(), &claims).is_err());
}

/// Of the issuer's clock, a minute; at the end there is no allowance.
#[test]
fn a_clock_that_is_ahead_by_a_minute_issues_what_holds_at_once_and_longer_is_not_taken() {
    let validity = Validity { not_before: NOW, not_after: NOW + 1000 };
    assert_eq!(validity.check(NOW - CLOCKS_DIFFER), Ok(()));
    let now = NOW - CLOCKS_DIFFER - 1;
    assert_eq!(validity.check(now), Err(CertError::NotYetValid { from: NOW, now }));
    assert_eq!(validity.check(NOW + 1000), Ok(()));
    assert_eq!(validity.check(NOW + 1001), Err(CertError::Expired { at: NOW + 1000, now: NOW + 1001 }));
    assert_eq!(Validity::ALWAYS.check(u64::MAX), Ok(()));
}

/// It starts in 1970: what it signs for a day has ended, and what others have signed has not begun.
/// Both errors name the clock.
#[test]
fn a_machine_that_does_not_know_the_time_is_told_to_look_at_its_clock() {
    let f = Fixture::new();
    let key = f.entity.key();
    let claims = RtCert { entity: f.entity.name(), switch: f.speaker.switch, not_after: 86400 };
    let at_the_rib = issue(key, &claims).unwrap().verify(&key.verify_key(), NOW).unwrap_err();
    assert_eq!(at_the_rib, CertError::Expired { at: 86400, now: NOW });
    let on_the_robot = f.ad_cert(|_| ()).verify(&f.owner.verify_key(), 0).unwrap_err();
    assert_eq!(on_the_robot, CertError::NotYetValid { from: NOW - 5, now: 0 });
    for error in [at_the_rib, on_the_robot] {
        assert!(error.to_string().contains("check the clock"), "{error}");
    }
}

struct Fixture {
    owner: SigningKey,
    entity: Identity,
    speaker: Requester,
    proof: NameProof,
    name: Name,
}

impl Fixture {
    fn new() -> Self {
        let owner = SigningKey::from_secret_bytes(&[1; 32]).unwrap();
        let entity = Identity::new(SigningKey::from_secret_bytes(&[2; 32]).unwrap(), "proxy");
        let proof = NameProof { owner_key: owner.public(), digest: name::inner_digest(&Default::default()) };
        let speaker = Requester {
            entity: entity.name(),
            entity_key: entity.key().verify_key(),
            switch: Name::from_bytes([4; 32]),
            floor: 10,
            now: NOW,
        };
        Self { name: proof.name().unwrap(), owner, entity, speaker, proof }
    }

    fn ad_cert_claims(&self) -> AdCert {
        let (name, entity) = (self.name, self.entity.name());
        AdCert { name, entity, scope: vec![], serial: 7, not_before: NOW - 5, not_after: NOW + 5 }
    }

    fn grant_claims(&self) -> ReadGrant {
        ReadGrant {
            name: self.name,
            to: Grantee::Entity(self.entity.name()),
            serial: 7,
            not_before: NOW - 5,
            not_after: NOW + 5,
        }
    }

    fn advert_claims(&self) -> Advert {
        let (name, entity, switch) = (self.name, self.entity.name(), self.speaker.switch);
        let box_key = self.entity.box_public();
        Advert { op: AdvertOp::Publish, name, entity, switch, serial: 11, lifetime: 60, box_key }
    }

    fn ad_cert(&self, change: impl FnOnce(&mut AdCert)) -> Signed<AdCert> {
        let mut claims = self.ad_cert_claims();
        change(&mut claims);
        issue(&self.owner, &claims).unwrap()
    }

    fn grant(&self, change: impl FnOnce(&mut ReadGrant)) -> Signed<ReadGrant> {
        let mut claims = self.grant_claims();
        change(&mut claims);
        issue(&self.owner, &claims).unwrap()
    }

    fn advert(&self, change: impl FnOnce(&mut Advert)) -> Signed<Advert> {
        let mut claims = self.advert_claims();
        change(&mut claims);
        issue(self.entity.key(), &claims).unwrap()
    }
}
