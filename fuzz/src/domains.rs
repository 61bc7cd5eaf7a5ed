//! What fuzzing of certificates and control messages begins with, as far as it is about trust
//! domains.

use gdp_core::cert::{
    Host, Invite, Locator, MemberCert, Membership, PeerCert, Revocation, Signed, SwitchStatement, issue,
};
use gdp_core::domain::{Credentials, Token};
use gdp_core::identity::{Identity, SigningKey};
use gdp_proto::control::{Extent, Request, TierEntry, TierKey, TierLeg, TierMessage, TierPush, TierRequest};
use gdp_wire::Name;

pub struct Domain {
    home: Identity,
    papers: Credentials,
    invited: Membership,
    host: Host,
    token: Token,
    revocation: Signed<Revocation>,
}

impl Domain {
    pub fn new() -> Self {
        let home = Identity::generate("domain").expect("an identity");
        let key = SigningKey::generate().expect("a key");
        let switch = Identity::generate("switch").expect("an identity");
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
        let addresses = vec![([192, 0, 2, 1], 31415).into()];
        let claims = SwitchStatement { switch: switch.name(), domain, addresses, serial, not_after };
        let statement = issue(switch.key(), &claims).expect("a statement");
        let invited = token.admit(switch.name(), 0, serial).expect("a membership");
        let host = Host { proof: switch.proof(), statement, membership: invited.clone() };
        let revocation = Revocation { name: domain, number: 3, floor: 2, revoked: vec![4, 1 << 60], signer: None };
        Self {
            papers: Credentials {
                membership: Membership::issue(&home, &member).expect("a membership"),
                peers: vec![peer],
            },
            invited,
            host,
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
            ("a switch statement", self.host.statement.as_bytes().to_vec()),
            ("a peer cert", self.papers.peers[0].as_bytes().to_vec()),
            ("a peer cert as text", self.papers.peers[0].to_pem().into_bytes()),
        ]
    }

    pub fn messages(&self) -> Vec<(&'static str, Request)> {
        let (switch, entity) = (Name::from_bytes([1; 32]), Name::from_bytes([2; 32]));
        let (proof, revocation) = (self.home.proof(), self.revocation.clone());
        let (reports, membership) = (self.host.proof, Some(Box::new(self.host.clone())));
        let locator = Locator { borders: vec![self.host.clone()] };
        let set = vec![TierEntry::Locator { domain: self.home.name(), locator }];
        let (extent, remove) = (Extent::Full { part: 0, last: true }, vec![TierKey::Locator(entity)]);
        let push = TierRequest::Push(Box::new(TierPush { run: 1, generation: 7, extent, set, remove }));
        vec![
            (
                "a switch's report",
                Request::Report { switch: reports, attached: vec![entity], own_bit: None, membership },
            ),
            ("tier push", Request::Tier(Box::new(TierMessage { leg: TierLeg::Across, request: push }))),
            ("papers", Request::Credentials(Box::new(self.papers.clone()))),
            ("domain revoked", Request::DomainRevoked { proof, revocation }),
            ("admitted", Request::Admitted { switch, entity, membership: Box::new(self.invited.clone()) }),
        ]
    }
}
