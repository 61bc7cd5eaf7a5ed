//! What fuzzing of certificates and control messages begins with, as far as it is about trust domains.

use gdp::cert::{Invite, MemberCert, Membership, PeerCert, Revocation, Signed, issue};
use gdp::control::Request;
use gdp::domain::{Papers, Token};
use gdp::{Identity, SigningKey};
use gdp_wire::Name;

pub struct Domain {
    home: Identity,
    papers: Papers,
    invited: Membership,
    token: Token,
    revocation: Signed<Revocation>,
}

impl Domain {
    pub fn new() -> Self {
        let home = Identity::generate("domain").expect("an identity");
        let key = SigningKey::generate().expect("a key");
        let (domain, entity, peer) = (home.name(), Name::from_bytes([2; 32]), Name::from_bytes([3; 32]));
        let (serial, not_before, not_after) = (7, 0, 1 << 40);
        let member = MemberCert { domain, entity, role: "switch".into(), serial, not_before, not_after };
        let rights = "peering,visit".parse().expect("rights");
        let peer = PeerCert { domain, peer, rights, serial, not_before, not_after };
        let peer = issue(home.key(), &peer).expect("a certificate");
        let (role, member_until) = ("switch".to_owned(), not_after);
        let invite = Invite { domain, key: key.verify_key(), role, serial, not_before, not_after, member_until };
        let invite = issue(home.key(), &invite).expect("an invitation");
        let at = "udp://edge.example:31415".parse().expect("a place");
        let token = Token::new(home.proof(), invite, key, at, Some(entity)).expect("a token");
        let revocation = Revocation { name: domain, number: 3, floor: 2, revoked: vec![4, 1 << 60] };
        Self {
            papers: Papers { membership: Membership::issue(&home, &member).expect("a membership"), peers: vec![peer] },
            invited: token.admit(entity, 0, serial).expect("a membership"),
            revocation: issue(home.key(), &revocation).expect("a revocation"),
            token,
            home,
        }
    }

    /// Files and lines.
    pub fn certificates(&self) -> Vec<(&'static str, Vec<u8>)> {
        let invite = self.invited.invite.as_ref().expect("one");
        vec![
            ("an invitation", invite.as_bytes().to_vec()),
            ("an invitation's line", self.token.to_line().as_bytes().to_vec()),
            ("a membership by invitation as text", self.invited.to_pem().into_bytes()),
            ("a peer cert", self.papers.peers[0].as_bytes().to_vec()),
            ("a peer cert as text", self.papers.peers[0].to_pem().into_bytes()),
        ]
    }

    pub fn messages(&self) -> Vec<(&'static str, Request)> {
        let (switch, entity) = (Name::from_bytes([1; 32]), Name::from_bytes([2; 32]));
        let (proof, revocation) = (self.home.proof(), self.revocation.clone());
        vec![
            ("papers", Request::Papers(Box::new(self.papers.clone()))),
            ("domain revoked", Request::DomainRevoked { proof, revocation }),
            ("admitted", Request::Admitted { switch, entity, membership: Box::new(self.invited.clone()) }),
        ]
    }
}
