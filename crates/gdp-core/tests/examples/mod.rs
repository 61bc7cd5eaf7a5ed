//! Certificates of fixed parties for tests that publish vectors. Signatures follow RFC 6979, so
//! they are the same in every run.
#![allow(dead_code, reason = "each test that includes this uses a part of it")]

use coset::TaggedCborSerializable;
use gdp_core::cbor;
use gdp_core::cert::domain::roles;
use gdp_core::cert::{
    AdCert, Adjoining, Advert, AdvertOp, Claims, Delegation, Enrollment, Grantee, Host, Invite, LinkState, MemberCert,
    Membership, MembershipRenewal, PeerCert, PeerRights, ReadGrant, RenewalDelegation, Revocation, RtCert, Signed,
    SwitchStatement, TopicsOf,
};
use gdp_core::crypto::Backend;
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::keys::KeyBox;
use gdp_core::name::{Name, NameProof};

pub const NOW: u64 = 1_800_000_000;
pub const SERIAL: u64 = NOW * 1_000_000_000;
const END: u64 = NOW + 3600;

/// Returns the private key whose 32 bytes are all `seed`.
pub fn key(seed: u8) -> SigningKey {
    SigningKey::from_secret_bytes(&[seed; 32]).unwrap()
}

/// Signs claims, also such as an issuer of this project refuses.
pub fn sign<T: Claims>(key: &SigningKey, claims: &T) -> Signed<T> {
    Signed::from_bytes(compose(key, T::CONTEXT, cbor::encode(claims).unwrap(), |cose| cose)).unwrap()
}

/// Composes a certificate as another implementation would.
pub fn compose(
    key: &SigningKey,
    context: &str,
    payload: Vec<u8>,
    change: impl FnOnce(coset::CoseSign1) -> coset::CoseSign1,
) -> Vec<u8> {
    let protected = coset::HeaderBuilder::new()
        .algorithm(coset::iana::Algorithm::ES256)
        .content_type(context.into())
        .key_id(key.public().to_vec())
        .build();
    let signer = key.signer(Backend::RustCrypto).unwrap();
    let cose = coset::CoseSign1Builder::new().protected(protected).payload(payload);
    let cose = cose.create_signature(context.as_bytes(), |message| signer.sign(message).unwrap().to_vec()).build();
    change(cose).to_tagged_vec().unwrap()
}

/// The parties: private keys are 32 bytes of the seed.
pub struct Parties {
    /// Seed 1; owns [`Self::topic`].
    pub owner: SigningKey,
    pub topic: NameProof,
    /// Seed 2.
    pub writer: Identity,
    /// Seed 3.
    pub reader: Identity,
    /// Seed 4.
    pub switch: Identity,
    /// Seed 5.
    pub domain: Identity,
    /// Seed 6: the key of an invitation.
    pub invited: SigningKey,
    /// Seed 7: the key of a delegation.
    pub delegate: SigningKey,
    /// Seed 8: the key of the join service.
    pub service: SigningKey,
    /// Seed 9.
    pub neighbour: Identity,
    /// Seed 10.
    pub away: Identity,
}

impl Parties {
    pub fn new() -> Self {
        let owner = key(1);
        let topic = NameProof { owner_key: owner.public(), digest: [0x11; 32] };
        let entity = |seed, kind: &str| Identity::new(key(seed), kind);
        Self {
            owner,
            topic,
            writer: entity(2, "proxy"),
            reader: entity(3, "proxy"),
            switch: entity(4, "switch"),
            domain: entity(5, "domain"),
            invited: key(6),
            delegate: key(7),
            service: key(8),
            neighbour: entity(9, "switch"),
            away: entity(10, "domain"),
        }
    }

    pub fn name(&self) -> Name {
        self.topic.name().unwrap()
    }

    pub fn ad_cert(&self) -> AdCert {
        let scope = vec![self.away.name()];
        let (name, entity) = (self.name(), self.writer.name());
        AdCert { name, entity, scope, serial: SERIAL + 2, not_before: NOW, not_after: END }
    }

    pub fn read_grant(&self) -> ReadGrant {
        let to = Grantee::Entity(self.reader.name());
        ReadGrant { name: self.name(), to, serial: SERIAL + 3, not_before: NOW, not_after: END }
    }

    pub fn role_grant(&self) -> ReadGrant {
        let to = Grantee::Role { domain: self.domain.name(), role: "viewer".into() };
        ReadGrant { to, ..self.read_grant() }
    }

    pub fn delegation(&self) -> Delegation {
        let (name, delegate) = (self.name(), self.delegate.verify_key());
        Delegation { name, delegate, publish: true, read: true, serial: SERIAL, not_before: NOW, not_after: END }
    }

    pub fn revocation(&self) -> Revocation {
        let revoked = vec![SERIAL + 7, SERIAL + 9];
        Revocation { name: self.name(), number: 2, floor: SERIAL - 1, revoked, signer: None }
    }

    pub fn member_cert(&self, entity: &Identity, role: &str) -> MemberCert {
        let (domain, entity, role) = (self.domain.name(), entity.name(), role.into());
        MemberCert { domain, entity, role, serial: SERIAL + 4, not_before: NOW, not_after: END }
    }

    pub fn invite(&self) -> Invite {
        let (domain, key, role) = (self.domain.name(), self.invited.verify_key(), "viewer".into());
        Invite { domain, key, role, serial: SERIAL + 1, not_before: NOW, not_after: NOW + 60, member_until: END }
    }

    pub fn renewal_delegation(&self) -> RenewalDelegation {
        let (domain, key) = (self.domain.name(), self.service.verify_key());
        let (member, serial, not_after) = (SERIAL + 4, SERIAL + 5, END + 7200);
        RenewalDelegation { domain, member, key, lifetime: 7200, serial, not_before: NOW, not_after }
    }

    pub fn enrollment(&self) -> Enrollment {
        let of = |member: &str, topics: &[&str]| TopicsOf {
            member: member.into(),
            topics: topics.iter().map(|topic| topic.to_string()).collect(),
        };
        Enrollment {
            domain: self.domain.name(),
            member: SERIAL + 4,
            label: "robot7".into(),
            expose: vec!["/camera/**".into(), "service:/plan".into()],
            import: vec![of("base", &["/map"])],
            read: vec![of("*", &["/tf"])],
            join_service: self.service.verify_key(),
            serial: SERIAL + 6,
            not_before: NOW,
            not_after: END,
        }
    }

    pub fn peer_cert(&self) -> PeerCert {
        let rights = PeerRights { peering: true, transit: false, visit: true };
        let (domain, peer) = (self.domain.name(), self.away.name());
        PeerCert { domain, peer, rights, serial: SERIAL + 7, not_before: NOW, not_after: END }
    }

    pub fn rt_cert(&self) -> RtCert {
        RtCert { entity: self.writer.name(), switch: self.switch.name(), not_after: END }
    }

    pub fn advert(&self, entity: &Identity, op: AdvertOp) -> Advert {
        let (name, switch, box_key) = (self.name(), self.switch.name(), entity.box_public());
        Advert { op, name, entity: entity.name(), switch, serial: 5, lifetime: 86_400, box_key }
    }

    pub fn switch_statement(&self) -> SwitchStatement {
        let addresses = ["192.0.2.1:31415", "[2001:db8::1]:31415"].map(|address| address.parse().unwrap());
        let (switch, domain, addresses) = (self.switch.name(), self.domain.name(), addresses.into());
        SwitchStatement { switch, domain, addresses, serial: SERIAL + 8, not_after: END }
    }

    pub fn link_state(&self) -> LinkState {
        let border = Adjoining {
            domain: self.away.name(),
            switch: Name::from_bytes([0x22; 32]),
            cost: 300,
            transit: true,
            ours_transit: false,
            parent: Some(0),
        };
        LinkState {
            switch: self.switch.name(),
            run: 7,
            number: 3,
            bit: Some(63),
            neighbours: vec![(self.neighbour.name(), 201)],
            silent: 1,
            rib: true,
            borders: vec![border],
            lifetime: 180,
        }
    }

    pub fn key_box(&self) -> KeyBox {
        let (name, writer, reader) = (self.name(), self.writer.name(), self.reader.name());
        KeyBox { name, writer, reader, epoch: 1_800_000_000, sealed: vec![0x5a; 113] }
    }

    /// Returns the membership of an entity by the domain's key.
    pub fn membership(&self, entity: &Identity, role: &str) -> Membership {
        let cert = sign(self.domain.key(), &self.member_cert(entity, role));
        Membership { domain: self.domain.proof(), cert, invite: None, renewal: None }
    }

    /// Returns a membership by an invitation, of these claims.
    pub fn invited(&self, claims: &MemberCert) -> Membership {
        let (cert, invite) = (sign(&self.invited, claims), sign(self.domain.key(), &self.invite()));
        Membership { domain: self.domain.proof(), cert, invite: Some(invite), renewal: None }
    }

    /// Returns a membership that was renewed by these claims.
    pub fn renewed(&self, claims: &MemberCert) -> Membership {
        let delegation = sign(self.domain.key(), &self.renewal_delegation());
        let renewal = MembershipRenewal { delegation, cert: sign(&self.service, claims) };
        Membership { renewal: Some(renewal), ..self.membership(&self.reader, "viewer") }
    }

    /// Returns the switch as other domains verify it.
    pub fn host(&self) -> Host {
        let statement = sign(self.switch.key(), &self.switch_statement());
        Host { proof: self.switch.proof(), statement, membership: self.membership(&self.switch, roles::BORDER) }
    }
}
