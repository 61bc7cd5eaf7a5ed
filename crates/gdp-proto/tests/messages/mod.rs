//! An example of each kind of request and response. The matches in `kinds` are exhaustive: a new
//! variant needs an arm there, and then an example here.

use std::collections::BTreeMap;

use gdp_core::cert::domain::roles;
use gdp_core::cert::{AdvertOp, Issued, Locator, Reading};
use gdp_core::domain::Credentials;
use gdp_core::name::Name;
use gdp_proto::control::*;

use crate::examples::{Parties, sign};

/// The variants within a message, outermost first.
pub trait Kinds {
    fn kinds(&self) -> Vec<&'static str>;
}

macro_rules! kinds {
    ($type:ident, $all:ident: $($name:literal = $pattern:pat => $inner:expr,)*) => {
        const $all: &[&str] = &[$($name),*];
        impl Kinds for $type {
            fn kinds(&self) -> Vec<&'static str> {
                let (name, inner): (&str, Vec<&str>) = match self { $($pattern => ($name, $inner),)* };
                [vec![name], inner].concat()
            }
        }
    };
}

kinds! { Request, REQUESTS:
    "Entity" = Request::Entity(request) => request.kinds(),
    "Onward" = Request::Onward { request, .. } => request.kinds(),
    "Relay" = Request::Relay { request, .. } => request.kinds(),
    "Report" = Request::Report { .. } => vec![],
    "Peerings" = Request::Peerings { .. } => vec![],
    "Tier" = Request::Tier(message) => [message.leg.kinds(), message.request.kinds()].concat(),
    "Flood" = Request::Flood { .. } => vec![],
    "Detach" = Request::Detach { .. } => vec![],
    "Ready" = Request::Ready => vec![],
    "Fib" = Request::Fib(push) => push.extent.kinds(),
    "Peers" = Request::Peers(push) => [push.role.kinds(), push.peers.kinds()].concat(),
    "WatchCosts" = Request::WatchCosts => vec![],
    "Costs" = Request::Costs(_) => vec![],
    "Ratcheted" = Request::Ratcheted { .. } => vec![],
    "Papers" = Request::Credentials(_) => vec![],
    "DomainRevoked" = Request::DomainRevoked { .. } => vec![],
    "Admitted" = Request::Admitted { .. } => vec![],
    "Traced" = Request::Traced(_) => vec![],
    "TraceOn" = Request::TraceOn(request) => request.leg.kinds(),
    "Inspect" = Request::Inspect(inspection) => inspection.kinds(),
}

kinds! { EntityRequest, ENTITY_REQUESTS:
    "Attach" = EntityRequest::Attach { .. } => vec![],
    "Advertise" = EntityRequest::Advertise { .. } => vec![],
    "Subscribe" = EntityRequest::Subscribe { .. } => vec![],
    "Withdraw" = EntityRequest::Withdraw { .. } => vec![],
    "KeyBoxes" = EntityRequest::KeyBoxes { .. } => vec![],
    "Revoke" = EntityRequest::Revoke { .. } => vec![],
    "Query" = EntityRequest::Query { .. } => vec![],
}

kinds! { Response, RESPONSES:
    "Done" = Response::Done => vec![],
    "Attached" = Response::Attached { .. } => vec![],
    "Reported" = Response::Reported { .. } => vec![],
    "Records" = Response::Records { records, .. } => records.iter().flat_map(Kinds::kinds).collect(),
    "Peers" = Response::Peers(peers) => peers.kinds(),
    "Tier" = Response::Tier(response) => response.kinds(),
    "Costs" = Response::Costs(_) => vec![],
    "TracedOn" = Response::TracedOn { domains } => domains.iter().flat_map(|domain| domain.crossing.kinds()).collect(),
    "Inspected" = Response::Inspected(inspected) => inspected.kinds(),
    "Refused" = Response::Refused(refusal) => refusal.code.kinds(),
}

kinds! { RefusalCode, CODES:
    "Malformed" = RefusalCode::Malformed => vec![],
    "NotAttached" = RefusalCode::NotAttached => vec![],
    "BadSignature" = RefusalCode::BadSignature => vec![],
    "WrongName" = RefusalCode::WrongName => vec![],
    "WrongEntity" = RefusalCode::WrongEntity => vec![],
    "WrongSwitch" = RefusalCode::WrongSwitch => vec![],
    "NotYetValid" = RefusalCode::NotYetValid => vec![],
    "Expired" = RefusalCode::Expired => vec![],
    "Revoked" = RefusalCode::Revoked => vec![],
    "NotEntitled" = RefusalCode::NotEntitled => vec![],
    "ReplayedSerial" = RefusalCode::ReplayedSerial => vec![],
    "NotFound" = RefusalCode::NotFound => vec![],
    "Limit" = RefusalCode::Limit => vec![],
    "Unreachable" = RefusalCode::Unreachable => vec![],
    "Unsupported" = RefusalCode::Unsupported => vec![],
    "Fenced" = RefusalCode::Fenced => vec![],
}

kinds! { TierLeg, TIER_LEGS:
    "leg Out" = TierLeg::Out { .. } => vec![],
    "leg Across" = TierLeg::Across => vec![],
    "leg In" = TierLeg::In { .. } => vec![],
}

kinds! { TierRequest, TIER_REQUESTS:
    "Hello" = TierRequest::Hello { .. } => vec![],
    "Push" = TierRequest::Push(push) => [
        push.extent.kinds(),
        push.set.iter().flat_map(Kinds::kinds).collect(),
        push.remove.iter().flat_map(Kinds::kinds).collect(),
    ].concat(),
    "Query to a parent" = TierRequest::Query { .. } => vec![],
}

kinds! { TierResponse, TIER_RESPONSES:
    "tier Done" = TierResponse::Done => vec![],
    "Partly" = TierResponse::Partly { .. } => vec![],
    "tier Hello" = TierResponse::Hello { .. } => vec![],
    "Answer" = TierResponse::Answer { entries, .. } => entries.iter().flat_map(Kinds::kinds).collect(),
    "tier Refused" = TierResponse::Refused(refusal) => refusal.code.kinds(),
}

kinds! { TierEntry, TIER_ENTRIES:
    "entry Part" = TierEntry::Part(part) => part.record.kinds(),
    "entry Box" = TierEntry::Box(_) => vec![],
    "entry Locator" = TierEntry::Locator { .. } => vec![],
    "entry Revocation" = TierEntry::Revocation { .. } => vec![],
}

kinds! { TierKey, TIER_KEYS:
    "key Part" = TierKey::Part(key) => key.role.kinds(),
    "key Box" = TierKey::Box { .. } => vec![],
    "key Locator" = TierKey::Locator(_) => vec![],
    "key Revocation" = TierKey::Revocation(_) => vec![],
}

kinds! { Extent, EXTENTS:
    "Delta" = Extent::Delta => vec![],
    "Full" = Extent::Full { .. } => vec![],
}

kinds! { PeersExtent, PEERS_EXTENTS:
    "After" = PeersExtent::After(_) => vec![],
    "Whole" = PeersExtent::Whole { .. } => vec![],
}

kinds! { NameRole, ROLES:
    "publisher" = NameRole::Publisher => vec![],
    "server" = NameRole::Server => vec![],
    "subscriber" = NameRole::Subscriber => vec![],
    "caller" = NameRole::Caller => vec![],
}

kinds! { Credential, CREDENTIALS:
    "Writer" = Credential::Writer(_) => vec![],
    "Reader" = Credential::Reader(_) => vec![],
}

kinds! { TraceLeg, TRACE_LEGS:
    "trace Out" = TraceLeg::Out { .. } => vec![],
    "trace Across" = TraceLeg::Across => vec![],
}

kinds! { Crossing, CROSSINGS:
    "crossing Traced" = Crossing::Traced { .. } => vec![],
    "Unanswered" = Crossing::Unanswered => vec![],
    "crossing Refused" = Crossing::Refused { .. } => vec![],
    "Loop" = Crossing::Loop => vec![],
    "TooFar" = Crossing::TooFar => vec![],
}

kinds! { Inspection, INSPECTIONS:
    "Status" = Inspection::Status => vec![],
    "Locate" = Inspection::Locate { .. } => vec![],
    "Probe" = Inspection::Probe { .. } => vec![],
}

kinds! { Inspected, INSPECTED:
    "answer Status" = Inspected::Status(_) => vec![],
    "Location" = Inspected::Location(_) => vec![],
    "answer Probe" = Inspected::Probe(_) => vec![],
}

impl Kinds for Record {
    fn kinds(&self) -> Vec<&'static str> {
        self.credential.kinds()
    }
}

impl Kinds for Peers {
    fn kinds(&self) -> Vec<&'static str> {
        [self.extent.kinds(), self.records.iter().flat_map(Kinds::kinds).collect()].concat()
    }
}

/// Returns the kinds that the examples must show.
pub fn all_kinds() -> Vec<&'static str> {
    let all = [
        REQUESTS,
        ENTITY_REQUESTS,
        RESPONSES,
        CODES,
        TIER_LEGS,
        TIER_REQUESTS,
        TIER_RESPONSES,
        TIER_ENTRIES,
        TIER_KEYS,
        EXTENTS,
        PEERS_EXTENTS,
        ROLES,
        CREDENTIALS,
        TRACE_LEGS,
        CROSSINGS,
        INSPECTIONS,
        INSPECTED,
    ];
    all.concat()
}

pub fn requests(parties: &Parties) -> Vec<Request> {
    let (switch, writer, reader, domain) =
        (parties.switch.name(), parties.writer.name(), parties.reader.name(), parties.away.name());
    let (name, revocation) = (parties.name(), sign(&parties.owner, &parties.revocation()));
    let membership = || parties.membership(&parties.switch, roles::BORDER);
    let onward = |request| Request::Onward { to: switch, hops: MAX_HOPS, request: Box::new(request) };
    let out = TierLeg::Out { domain, peer: parties.neighbour.name() };
    let tier = |leg, request| Request::Tier(Box::new(TierMessage { leg, request }));
    let key = |role| RecordKey { name, role, entity: writer, switch };
    let push = TierPush {
        run: 9,
        generation: 1,
        extent: Extent::Full { part: 0, last: true },
        set: entries(parties),
        remove: vec![
            TierKey::Part(key(NameRole::Server)),
            TierKey::Part(key(NameRole::Caller)),
            TierKey::Box { writer, reader, name, epoch: 1_800_000_000 },
            TierKey::Locator(domain),
            TierKey::Revocation(name),
        ],
    };
    let fib = |extent, settling| FibPush {
        switch,
        run: 9,
        settling,
        generation: 1,
        extent,
        own_bit: 63,
        set: vec![Route {
            name,
            egress_bits: 1 << 63 | 1,
            locals: vec![reader],
            everywhere: vec![reader],
            writers: vec![writer],
            arrives_by: vec![],
        }],
        remove: vec![parties.neighbour.name()],
    };
    let peers = |extent, role| PeersPush { switch, entity: reader, name, role, peers: peers(parties, extent) };
    let mut requests: Vec<Request> = entity_requests(parties).into_iter().map(Request::Entity).collect();
    let relayed = entity_requests(parties).remove(1);
    requests.extend([
        onward(Request::Relay { switch, entity: Some(parties.writer.proof()), by_tool: false, request: relayed }),
        onward(Request::Report {
            switch: parties.switch.proof(),
            attached: vec![writer, reader],
            own_bit: Some(63),
            membership: Some(Box::new(parties.host())),
        }),
        onward(Request::Peerings {
            run: 9,
            wanted: vec![(parties.neighbour.name(), parties.switch_statement().addresses)],
        }),
        onward(tier(out, TierRequest::Hello { run: 9, holds: None })),
        tier(TierLeg::Across, TierRequest::Push(Box::new(push))),
        onward(tier(TierLeg::In { from: domain }, TierRequest::Query { name, path: vec![domain] })),
        Request::Flood {
            states: vec![Flooded {
                proof: parties.switch.proof(),
                state: sign(parties.switch.key(), &parties.link_state()),
                expires_in: 180,
            }],
        },
        Request::Detach { switch, entity: writer },
        Request::Ready,
        onward(Request::Fib(fib(Extent::Full { part: 0, last: false }, true))),
        onward(Request::Fib(fib(Extent::Delta, false))),
        onward(Request::Peers(peers(PeersExtent::Whole { part: 0, last: true }, NameRole::Subscriber))),
        Request::Peers(peers(PeersExtent::After(4), NameRole::Publisher)),
        Request::WatchCosts,
        Request::Costs(costs(parties)),
        Request::Ratcheted { generation: 1 },
        Request::Credentials(Box::new(Credentials {
            membership: membership(),
            peers: vec![sign(parties.domain.key(), &parties.peer_cert())],
        })),
        Request::DomainRevoked { proof: parties.topic, revocation },
        onward(Request::Admitted { switch, entity: reader, membership: Box::new(membership()) }),
        onward(Request::Traced(Traced {
            cookie: 1 << 63,
            switch,
            end: Some(TracedEnd { links: 1, beyond: vec![(domain, parties.neighbour.name())] }),
        })),
        Request::Traced(Traced { cookie: 0, switch, end: None }),
        Request::TraceOn(TraceOn { leg: TraceLeg::Across, name, path: vec![domain], within_ms: 4000 }),
        onward(Request::TraceOn(TraceOn {
            leg: TraceLeg::Out { domain, peer: parties.neighbour.name() },
            name,
            path: vec![domain],
            within_ms: 4000,
        })),
        Request::Inspect(Inspection::Status),
        Request::Inspect(Inspection::Locate { name }),
        Request::Inspect(Inspection::Probe { name, egress: switch, hops: 3 }),
    ]);
    requests
}

fn entity_requests(parties: &Parties) -> Vec<EntityRequest> {
    let (owner, writer, reader) = (&parties.owner, parties.writer.key(), parties.reader.key());
    let proof = parties.topic;
    let statement = |op| sign(writer, &parties.advert(&parties.writer, op));
    let delegation = Some(sign(owner, &parties.delegation()));
    let role = Reading {
        grant: Issued::from(sign(owner, &parties.role_grant())),
        member: Some(Box::new(parties.membership(&parties.reader, "viewer"))),
    };
    let after = RecordKey {
        name: parties.name(),
        role: NameRole::Publisher,
        entity: parties.writer.name(),
        switch: parties.switch.name(),
    };
    vec![
        EntityRequest::Attach { rt_cert: sign(writer, &parties.rt_cert()), resumes: false, lane: 3 },
        EntityRequest::Advertise {
            proof,
            ad_cert: Issued { cert: sign(&parties.delegate, &parties.ad_cert()), delegation },
            advert: statement(AdvertOp::Publish),
            everywhere: true,
        },
        EntityRequest::Subscribe {
            proof,
            grant: role,
            advert: sign(reader, &parties.advert(&parties.reader, AdvertOp::Subscribe)),
            everywhere: false,
        },
        EntityRequest::Withdraw { advert: statement(AdvertOp::Withdraw) },
        EntityRequest::KeyBoxes { boxes: vec![sign(writer, &parties.key_box())] },
        EntityRequest::Revoke { proof, revocation: sign(owner, &parties.revocation()) },
        EntityRequest::Query { prefix: "75e".parse().unwrap(), after: None },
        EntityRequest::Query { prefix: parties.name().into(), after: Some(after) },
    ]
}

pub fn responses(parties: &Parties) -> Vec<Response> {
    let (switch, domain) = (parties.switch.name(), parties.away.name());
    let tier = |response| Response::Tier(Box::new(response));
    let codes = [
        RefusalCode::Malformed,
        RefusalCode::NotAttached,
        RefusalCode::BadSignature,
        RefusalCode::WrongName,
        RefusalCode::WrongEntity,
        RefusalCode::WrongSwitch,
        RefusalCode::NotYetValid,
        RefusalCode::Expired,
        RefusalCode::Revoked,
        RefusalCode::NotEntitled,
        RefusalCode::ReplayedSerial,
        RefusalCode::NotFound,
        RefusalCode::Limit,
        RefusalCode::Unreachable,
        RefusalCode::Unsupported,
        RefusalCode::Fenced,
    ];
    let crossed = |crossing| TracedDomain { depth: 1, domain, entry: switch, rtt_us: Some(900), crossing };
    let switches = vec![TracedSwitch { hop: 1, switch: None, rtt_us: None }];
    let mut responses = vec![
        Response::Done,
        Response::Attached { serial: 4 },
        Response::Reported { run: 9 },
        Response::Records { records: records(parties), truncated: true },
        Response::Peers(peers(parties, PeersExtent::Whole { part: 0, last: false })),
        tier(TierResponse::Done),
        tier(TierResponse::Partly { refused: 1, reason: "full".into() }),
        tier(TierResponse::Hello { run: 9, holds: Some(TierHolds { run: 8, generation: 7 }), ancestors: vec![domain] }),
        tier(TierResponse::Answer { entries: entries(parties), truncated: false }),
        tier(TierResponse::Refused(Refusal::new(RefusalCode::Limit, "full"))),
        Response::Costs(costs(parties)),
        Response::TracedOn {
            domains: vec![
                crossed(Crossing::Traced { links: 1, time_us: Some(1000), switches: Some(switches) }),
                crossed(Crossing::Traced { links: 1, time_us: None, switches: None }),
                crossed(Crossing::Unanswered),
                crossed(Crossing::Refused { reason: "busy".into() }),
                crossed(Crossing::Loop),
                crossed(Crossing::TooFar),
            ],
        },
        Response::Inspected(Inspected::Status(Box::new(status(parties)))),
        Response::Inspected(Inspected::Location(NameLocation { egress: vec![switch], links: 1 })),
        Response::Inspected(Inspected::Probe(ProbeEnd { switch: Some(switch), links: None })),
    ];
    responses.extend(codes.map(|code| Refusal::new(code, "the reason, for people").into()));
    responses
}

fn records(parties: &Parties) -> Vec<Record> {
    let record = |credential, entity: &gdp_core::identity::Identity, op| Record {
        name: parties.name(),
        proof: parties.topic,
        entity: entity.proof(),
        switch: parties.switch.name(),
        credential,
        advert: sign(entity.key(), &parties.advert(entity, op)),
        expires_in: 3600,
    };
    let (ad, grant) = (sign(&parties.owner, &parties.ad_cert()), sign(&parties.owner, &parties.read_grant()));
    vec![
        record(Credential::Writer(ad.into()), &parties.writer, AdvertOp::Publish),
        record(Credential::Reader(grant.into()), &parties.reader, AdvertOp::Subscribe),
    ]
}

fn peers(parties: &Parties, extent: PeersExtent) -> Peers {
    Peers {
        run: 9,
        settling: true,
        generation: 5,
        extent,
        records: records(parties),
        departed: vec![parties.neighbour.name()],
        revocation: Some(sign(&parties.owner, &parties.revocation())),
        boxes: vec![sign(parties.writer.key(), &parties.key_box())],
    }
}

fn entries(parties: &Parties) -> Vec<TierEntry> {
    let record = records(parties).remove(0);
    let part = RemoteRecord { record, host: parties.host(), path: vec![parties.domain.name()] };
    vec![
        TierEntry::Part(Box::new(part)),
        TierEntry::Box(sign(parties.writer.key(), &parties.key_box())),
        TierEntry::Locator { domain: parties.domain.name(), locator: Locator { borders: vec![parties.host()] } },
        TierEntry::Revocation { proof: parties.topic, revocation: sign(&parties.owner, &parties.revocation()) },
    ]
}

fn costs(parties: &Parties) -> BTreeMap<Name, u64> {
    [(parties.switch.name(), 0), (parties.neighbour.name(), 201)].into()
}

fn status(parties: &Parties) -> AttachmentStatus {
    let link = OwnLink {
        lane: 0,
        address: "192.0.2.7:40000".into(),
        mtu: 1500,
        rtt_us: 900,
        age_s: 60,
        admitted_until: Some(1_800_003_600),
    };
    let name = OwnName { name: parties.name(), sends: true, receives: false, has_receivers: true };
    AttachmentStatus {
        switch: parties.switch.name(),
        release: "0.1.0".into(),
        domain: Some(parties.domain.name()),
        data_plane: "userspace".into(),
        no_rib: None,
        links: vec![link],
        names: vec![name],
        truncated: false,
    }
}
