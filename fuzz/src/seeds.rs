//! What fuzzing begins with, by target and name: a whole and right input of each kind. Made by the
//! code under test, so that they are messages of this version, and not of the one before.

use gdp_core::card::NameCard;
use gdp_core::cert::{
    AdCert, Adjoining, Advert, AdvertOp, Delegation, Grantee, Issued, LinkState, MemberCert, Membership, ReadGrant,
    Reading, Revocation, RtCert, Signed, issue,
};
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::keys::KeyBox;
use gdp_e2e::feedback_wire::{Feedback, Missing, Wants};
use gdp_proto::control::{
    Credential, Crossing, EntityRequest, Extent, FibPush, Flooded, MAX_HOPS, NameRole, Peers, PeersExtent, PeersPush,
    Record, Refusal, RefusalCode, Request, Response, Route, TierLeg, TierMessage, TierRequest, TraceLeg, TraceOn,
    TracedDomain, TracedSwitch, encode,
};
use gdp_wire::{Counter, Name};
use serde::Serialize;

use crate::decide::{TAGGED, TWICE};
use crate::domains::Domain;
use crate::frames::fixtures;
use crate::{call, key_box, msg, ros1};

type Seeds = Vec<(String, Vec<u8>)>;

/// Of the target with this name.
pub fn seeds(target: &str) -> Seeds {
    match target {
        "decide" => frames(),
        "control" => Credentials::new().messages(),
        "cert" => Credentials::new().certificates(),
        "feedback" => feedback(),
        "key_box" => key_box::seeds(),
        "segments" => payloads(),
        "msg" => msg::seeds(),
        "call" => call::seeds(),
        "xmlrpc" => ros1::documents(),
        "ros1_header" => ros1::headers(),
        _ => Vec::new(),
    }
}

/// The fixtures, each twice in a row; what becomes of one by mutation has a good tag, unless that
/// is what the fixture is about.
fn frames() -> Seeds {
    let input = |options: u8, frame: Vec<u8>| [&[options][..], &(frame.len() as u16).to_be_bytes(), &frame].concat();
    let cases = fixtures::read().cases.into_iter().map(|case| {
        let tagged = if case.kernel.counter == Counter::BadTag.as_str() { 0 } else { TAGGED };
        (case.name, input(TWICE | tagged, case.frame.bytes()))
    });
    cases.filter(|(_, input)| input.len() < 1000).collect()
}

fn feedback() -> Seeds {
    let (name, session, challenge) = (Name::from_bytes([1; 32]), [2; 16], [3; 16]);
    let (highest, received_segments, received_bytes, ce) = (7, 8, 9, 1);
    let (echo, echo_index, delay_us) = (7, 1, 100);
    let seeds = [
        ("hello", Feedback::Hello { name, challenge, wants: Wants::Every }),
        ("welcome", Feedback::Welcome { name, challenge, session, sequence: 5, history: 1024 }),
        (
            "report",
            Feedback::Report {
                name,
                session,
                highest,
                acknowledged: 6,
                received_segments,
                received_bytes,
                needless_bytes: 0,
                ce,
                echo,
                echo_index,
                delay_us,
            },
        ),
        (
            "nack",
            Feedback::Nack {
                name,
                session,
                highest: 7,
                highest_index: 1,
                waited_us: 500,
                missing: vec![Missing::whole(4), Missing::whole(6)],
            },
        ),
        ("gone", Feedback::Unavailable { name, session, oldest: 5 }),
        ("clock", Feedback::Clock { name, session, challenge: [4; 16], unix_ns: 6 }),
        ("time", Feedback::ClockAnswer { name, challenge: [4; 16], unix_ns: 7 }),
    ];
    let encode = |feedback: &Feedback| {
        let mut bytes = Vec::new();
        feedback.encode(&mut bytes).expect("within the bounds");
        bytes
    };
    seeds.iter().map(|(name, feedback)| ((*name).to_owned(), encode(feedback))).collect()
}

/// What goes well between a writer and a reader, and what another reader may try.
fn payloads() -> Seeds {
    use crate::segments::{ARRIVE, EPOCHS, INSIDER, PAYLOAD, TIME, VOUCH, WRITER};
    let step = |kind: u8, bytes: &[u8]| [&[kind][..], &(bytes.len() as u16).to_be_bytes(), bytes].concat();
    let send = |what: u8, size: u8, length: usize| step(WRITER, &[&[what, size][..], &vec![what; length]].concat());
    let arrive = |which: u8| step(ARRIVE, &[which, 0]);
    // A segment of zeros, in the writer's session.
    let header = |kind: u8, plaintext: u16, index: u32, count: u32, size: u32| {
        let mut header = vec![gdp_e2e::seal::SEGMENT_VERSION, kind];
        header.extend((plaintext + 16).to_be_bytes());
        header.extend(index.to_be_bytes());
        header.extend([0, 0, 0, 0, 0, 1, 0, 0]);
        header.extend([0; 16]);
        [count, size, 1].iter().for_each(|word| header.extend(word.to_be_bytes()));
        [header, vec![0; plaintext.into()]].concat()
    };
    let (body, end) = (header(0, 20, 0, 2, 20), header(1, 68, 1, 2, 20));
    let (whole, bundle) = (header(1, 20 + 68, 0, 1, 20), header(3, 8 + 2 * 6 + 68, 0, 2, 20));
    [
        ("a message in one frame", vec![send(255, 255, 100), arrive(0)]),
        ("a batch", vec![send(7, 255, 200), arrive(0), arrive(0)]),
        (
            "a large message",
            vec![send(255, 10, 1000), arrive(3), arrive(2), arrive(0), arrive(0), arrive(0), arrive(0)],
        ),
        ("two cuts", vec![send(255, 40, 700), send(1, 10, 0), arrive(0), arrive(3), arrive(2), arrive(1), arrive(0)]),
        ("a heartbeat", vec![send(255, 255, 9), step(WRITER, &[0, 0]), arrive(1), arrive(0)]),
        ("another epoch", vec![step(EPOCHS, &[1]), send(255, 255, 100), arrive(0), step(EPOCHS, &[4]), arrive(0)]),
        ("too late", vec![send(255, 10, 1000), arrive(0), step(TIME, &[255, 255]), arrive(0)]),
        ("damage", vec![send(255, 255, 100), step(ARRIVE, &[0, 1, 0, 60, 4]), arrive(0)]),
        ("another session", vec![step(VOUCH, &[5; 20]), send(255, 255, 100), arrive(0)]),
        ("a forged message", vec![step(INSIDER, &[&body[..], &end].concat()), send(255, 255, 100), arrive(0)]),
        ("a forged end first", vec![step(INSIDER, &end), step(INSIDER, &body)]),
        ("a forged small message", vec![step(INSIDER, &whole), send(255, 255, 100), arrive(0)]),
        ("a forged bundle", vec![step(INSIDER, &bundle), send(7, 255, 200), arrive(0)]),
        ("half a large message", vec![step(INSIDER, &header(0, 20, 1, 100, 20))]),
        (
            "a forged heartbeat",
            vec![step(INSIDER, &{
                let mut heartbeat = header(2, 80, 7, 0, 0);
                heartbeat[14..16].fill(255);
                heartbeat
            })],
        ),
        ("what nobody sealed", vec![step(PAYLOAD, &[&body[..], &[0; 16]].concat())]),
    ]
    .map(|(name, steps)| (name.to_owned(), steps.concat()))
    .to_vec()
}

/// One of each.
struct Credentials {
    card: NameCard,
    robot: Identity,
    ad_cert: Issued<AdCert>,
    grant: Reading,
    revocation: Signed<Revocation>,
    rt_cert: Signed<RtCert>,
    advert: Signed<Advert>,
    state: Signed<LinkState>,
}

impl Credentials {
    fn new() -> Self {
        let (owner, robot) =
            (SigningKey::generate().expect("a key"), Identity::generate("proxy").expect("an identity"));
        let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "T", None).expect("a card");
        let (name, entity, switch) = (card.name(), robot.name(), card.name());
        let (serial, not_before, not_after) = (7, 0, 1 << 40);
        let (scope, box_key) = (vec![name], robot.box_public());
        let ad_cert = AdCert { name, entity, scope, serial, not_before, not_after };
        let (delegate, publish, read) = (robot.key().verify_key(), true, true);
        let delegation = Delegation { name, delegate, publish, read, serial, not_before, not_after };
        let delegation = issue(&owner, &delegation).expect("a delegation");
        let home = Identity::generate("domain").expect("an identity");
        let (domain, role) = (home.name(), "operator".to_owned());
        let member = MemberCert { domain, entity, role: role.clone(), serial, not_before, not_after };
        let grant = ReadGrant { name, to: Grantee::Role { domain, role }, serial, not_before, not_after };
        let grant = issue(robot.key(), &grant).expect("a grant");
        let advert = Advert { op: AdvertOp::Publish, name, entity, switch, serial, lifetime: 60, box_key };
        let neighbours = vec![(Name::default(), 200), (Name::from_bytes([0xff; 32]), u32::MAX)];
        let border = Adjoining { domain, switch, cost: 500, transit: true, ours_transit: false, parent: Some(1) };
        let state = LinkState {
            switch: entity,
            run: 1 << 60,
            number: 1,
            bit: Some(63),
            neighbours,
            silent: 2,
            rib: true,
            borders: vec![border],
            lifetime: 180,
        };
        let revocation = Revocation { name, number: 3, floor: 2, revoked: vec![4, 1 << 60], signer: None };
        Self {
            ad_cert: issue(&owner, &ad_cert).expect("a certificate").into(),
            grant: Reading {
                grant: Issued { cert: grant, delegation: Some(delegation) },
                member: Some(Box::new(Membership::issue(&home, &member).expect("a membership"))),
            },
            revocation: issue(&owner, &revocation).expect("a revocation"),
            rt_cert: issue(robot.key(), &RtCert { entity, switch, not_after }).expect("a certificate"),
            advert: issue(robot.key(), &advert).expect("a statement"),
            state: issue(robot.key(), &state).expect("a statement"),
            card,
            robot,
        }
    }

    fn certificates(&self) -> Seeds {
        [
            ("an ad cert", self.ad_cert.cert.as_bytes().to_vec()),
            ("a read grant", self.grant.grant.cert.as_bytes().to_vec()),
            ("a revocation", self.revocation.as_bytes().to_vec()),
            ("a grant to a role as text", self.grant.to_pem().into_bytes()),
            ("a delegation", self.grant.grant.delegation.as_ref().expect("one").as_bytes().to_vec()),
            ("a member cert", self.grant.member.as_ref().expect("one").cert.as_bytes().to_vec()),
            ("a membership as text", self.grant.member.as_ref().expect("one").to_pem().into_bytes()),
            ("a revocation as text", self.revocation.to_pem().into_bytes()),
            ("an rt cert", self.rt_cert.as_bytes().to_vec()),
            ("an advert", self.advert.as_bytes().to_vec()),
            ("a link state", self.state.as_bytes().to_vec()),
            ("an ad cert as text", self.ad_cert.to_pem().into_bytes()),
            ("a name card", self.card.to_json().into_bytes()),
        ]
        .into_iter()
        .chain(Domain::new().certificates())
        .map(|(name, bytes)| (name.to_owned(), bytes))
        .collect()
    }

    fn messages(&self) -> Seeds {
        let (name, entity, switch) = (self.card.name(), self.robot.name(), self.card.name());
        let (proof, robot) = (self.card.proof(), self.robot.proof());
        let Self { ad_cert, grant, rt_cert, advert, .. } = self;
        let advertise =
            EntityRequest::Advertise { proof, ad_cert: ad_cert.clone(), advert: advert.clone(), everywhere: true };
        let record = Record {
            name,
            proof,
            entity: robot,
            switch,
            credential: Credential::Writer(ad_cert.clone()),
            advert: advert.clone(),
            expires_in: 60,
        };
        let place = record.key().ok();
        let route = Route {
            name,
            egress_bits: 3,
            locals: vec![entity],
            everywhere: vec![entity],
            writers: vec![entity],
            arrives_by: vec![switch],
        };
        let push = FibPush {
            switch,
            run: 1,
            settling: true,
            generation: 7,
            extent: Extent::Full { part: 0, last: true },
            own_bit: 63,
            set: vec![route],
            remove: vec![name],
        };
        let key = KeyBox { name, writer: entity, reader: entity, epoch: 5, sealed: vec![0; 113] };
        let peers = Peers {
            run: 1,
            settling: true,
            generation: 7,
            extent: PeersExtent::Whole { part: 0, last: false },
            records: vec![record.clone()],
            departed: vec![entity],
            revocation: Some(self.revocation.clone()),
            boxes: vec![issue(self.robot.key(), &key).expect("a box")],
        };
        let role = NameRole::Subscriber;
        let from_entity = Request::Entity;
        let asked = TierRequest::Query { name, path: vec![switch, entity] };
        let tier = TierMessage { leg: TierLeg::In { from: entity }, request: asked };
        let leg = TraceLeg::Out { domain: entity, peer: switch };
        let hop = TracedSwitch { hop: 1, switch: Some(switch), rtt_us: Some(300) };
        let crossing = Crossing::Traced { links: 1, time_us: Some(300), switches: Some(vec![hop]) };
        let traced = TracedDomain { depth: 1, domain: entity, entry: switch, rtt_us: None, crossing };
        let onward = |request| Request::Onward { to: switch, hops: MAX_HOPS, request: Box::new(request) };
        let of_domains = Domain::new().messages();
        let of_domains = of_domains.iter().map(|(name, request)| seed(name, request));
        of_domains
            .chain([
                seed(
                    "attach",
                    &from_entity(EntityRequest::Attach { rt_cert: rt_cert.clone(), resumes: true, lane: 1 }),
                ),
                seed(
                    "relay",
                    &onward(Request::Relay { switch, entity: Some(robot), by_tool: false, request: advertise }),
                ),
                seed(
                    "subscribe",
                    &from_entity(EntityRequest::Subscribe {
                        proof,
                        grant: grant.clone(),
                        advert: advert.clone(),
                        everywhere: true,
                    }),
                ),
                seed("withdraw", &from_entity(EntityRequest::Withdraw { advert: advert.clone() })),
                seed("query", &from_entity(EntityRequest::Query { prefix: name.into(), after: place })),
                seed(
                    "report",
                    &onward(Request::Report {
                        switch: robot,
                        attached: vec![entity],
                        own_bit: Some(63),
                        membership: None,
                    }),
                ),
                seed(
                    "peerings",
                    &onward(Request::Peerings { run: 7, wanted: vec![(switch, vec![([192, 0, 2, 1], 31415).into()])] }),
                ),
                seed("tier query", &Request::Tier(Box::new(tier))),
                seed("trace on", &Request::TraceOn(TraceOn { leg, name, path: vec![switch, entity], within_ms: 4000 })),
                seed("traced on", &Response::TracedOn { domains: vec![traced] }),
                seed(
                    "flood",
                    &Request::Flood {
                        states: vec![Flooded { proof: robot, state: self.state.clone(), expires_in: 180 }],
                    },
                ),
                seed("revoke", &from_entity(EntityRequest::Revoke { proof, revocation: self.revocation.clone() })),
                seed("detach", &Request::Detach { switch, entity }),
                seed("ready", &Request::Ready),
                seed("watch costs", &Request::WatchCosts),
                seed("costs", &Request::Costs([(switch, 7)].into())),
                seed("fib push", &onward(Request::Fib(push))),
                seed("key boxes", &from_entity(EntityRequest::KeyBoxes { boxes: peers.boxes.clone() })),
                seed("peers push", &Request::Peers(PeersPush { switch, entity, name, role, peers: peers.clone() })),
                seed("peers", &Response::Peers(peers)),
                seed("ratcheted", &Request::Ratcheted { generation: u64::MAX }),
                seed("done", &Response::Done),
                seed("attached", &Response::Attached { serial: 9 }),
                seed("reported", &Response::Reported { run: 9 }),
                seed("records", &Response::Records { records: vec![record], truncated: true }),
                seed("refused", &Response::from(Refusal::new(RefusalCode::Limit, "full"))),
            ])
            .collect()
    }
}

/// Without the length in front.
fn seed(name: &str, message: &impl Serialize) -> (String, Vec<u8>) {
    (name.to_owned(), encode(message).expect("a message that fits")[4..].to_vec())
}
