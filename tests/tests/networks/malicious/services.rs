//! A malicious client next to another client of the same service. The switch copies all traffic to
//! it, and the RIB shows it every key box. Requests are sealed under a client key that the server
//! alone receives. Replies are sealed under a server key that the one client alone receives. A
//! malicious server next to another one can do no more.

use std::sync::{Arc, Mutex};

use anyhow::{Context, Result};
use gdp::unstable::{Client, Node, Server};
use gdp_core::cert::{Signed, issue};
use gdp_core::crypto::Backend;
use gdp_core::identity::Identity;
use gdp_core::keys::{self, EpochKey, KeyBox};
use gdp_e2e::seal::{Draft, Encoding, MessageId, Segments, Writer};
use gdp_proto::control::{EntityRequest, NameRole, RefusalCode, Response};
use gdp_wire::Name;
use tokio::time::timeout;

use crate::evil::{Frame, Owner, Rogue, Switch, drops, eventually, frames, node};
use gdp_tests::wait::TIMEOUT;

/// First byte of a sealed segment, and of nothing else that an entity receives under its own name.
const SEGMENT: u8 = gdp_e2e::seal::SEGMENT_VERSION;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn another_client_reads_neither_requests_nor_replies() -> Result<()> {
    let mut service = Service::start().await?;
    let client = service.client_node.name();
    let (reply, ()) = tokio::try_join!(
        async { Ok(timeout(TIMEOUT, service.client.call(Encoding::Bytes, b"where to?")).await??) },
        async {
            let call = timeout(TIMEOUT, service.server.recv()).await?.context("a call")?;
            assert_eq!((&call.body()[..], call.client()), (&b"where to?"[..], client));
            anyhow::Ok(call.reply(Encoding::Bytes, b"home").await?)
        },
    )?;
    assert_eq!((&reply.body[..], reply.writer), (&b"home"[..], service.server_identity.name()));

    let (name, server) = (service.owner.name(), service.server_identity.name());
    let parties = [(server, &service.client_identity), (client, &service.server_identity)];
    let other = &mut service.other;
    let mut seen = Vec::new();
    eventually("both to come to the other client as well", || {
        seen.extend(other.listen(&service.switch));
        parties.iter().all(|(to, from)| of(&seen, *to, from.name()).next().is_some()).then_some(())
    })?;
    for (to, from) in parties {
        assert!(other.read(to, from, &seen)?.is_empty());
        assert!(of(&seen, to, from.name()).all(|frame| !contains(frame, b"where to?") && !contains(frame, b"home")));
    }
    assert!(seen.iter().all(|frame| frame.destination != name), "nothing goes to the service itself");
    for signed in other.boxes() {
        let claims = signed.claims_unverified()?;
        assert_eq!((claims.reader, claims.name), (other.name(), other.name()), "of what the server would reply to it");
    }
    // Boxes that a RIB gives to others are useless to them.
    let mut boxes = service.boxes.lock().unwrap().clone();
    boxes.retain(|signed| signed.claims_unverified().is_ok_and(|claims| claims.reader != other.name()));
    assert!(boxes.len() >= 2, "one each way");
    for signed in &boxes {
        let claims = signed.claims_unverified()?;
        let (_, writer) = parties.iter().find(|(_, writer)| writer.name() == claims.writer).context("a writer")?;
        let key = writer.key().verify_key();
        for reader in [other.name(), claims.reader] {
            let as_reader = (reader, other.identity.box_key());
            assert!(keys::open(signed, claims.name, (writer.name(), &key), as_reader).is_err());
        }
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_answers_no_other_client() -> Result<()> {
    let mut service = Service::start().await?;
    let (robot, to) = (service.server_identity.name(), service.client_node.name());
    let Service { switch, server, client_identity, client_node, client, other, .. } = &mut service;
    // The rogue is no counterpart of the client. The RIB accepts no box from it for the client's
    // inbox, also not in the server's name.
    let key = EpochKey::generate()?;
    let own = keys::wrap(to, &other.identity, (to, &client_identity.box_public()), 1, &key)?;
    let claims = KeyBox { writer: robot, ..own.claims_unverified()? };
    let in_the_servers_name = issue(other.identity.key(), &claims)?;
    for (boxed, code) in [(&own, RefusalCode::NotEntitled), (&in_the_servers_name, RefusalCode::WrongEntity)] {
        match switch.ask(Some(&other.identity.proof()), &EntityRequest::KeyBoxes { boxes: vec![boxed.clone()] }) {
            Response::Refused(refused) => assert_eq!(refused.code, code, "{refused}"),
            taken => panic!("taken: {taken:?}"),
        }
    }
    // Even if a RIB delivers these boxes, the client does not accept them.
    let told = switch.tell(to, (to, NameRole::Subscriber), vec![], None, vec![own, in_the_servers_name]).await?;
    assert!(matches!(told, Response::Done), "{told:?}");

    // The rogue sees the request and answers before the server does: as itself, and as the server.
    let call = client.call(Encoding::Bytes, b"where to?");
    let answered = async {
        let request = timeout(TIMEOUT, server.recv()).await?.context("a call")?;
        let asked = eventually("the request", || {
            let frames = other.listen(switch);
            of(&frames, robot, to).next().cloned()
        })?;
        let in_reply_to = Some(message_id(&asked));
        for (source, reason) in [(other.name(), "seal_unknown_writer"), (robot, "seal_no_key")] {
            let mut writer = Writer::new(to, source, other.identity.key().clone(), Backend::selected())?;
            writer.set_epoch(1, &key)?;
            let (mut segments, draft) =
                (Segments::new(), Draft { in_reply_to, ..Draft::new(Encoding::Bytes, b"hell") });
            writer.seal_batch(0, &[draft], 1000, &mut segments)?;
            switch.inject(&frames(&segments, to, source, to));
            drops(client_node, reason, 1)?;
        }
        anyhow::Ok(request.reply(Encoding::Bytes, b"home").await?)
    };
    let (reply, ()) = tokio::try_join!(async { Ok(timeout(TIMEOUT, call).await??) }, answered)?;
    assert_eq!((&reply.body[..], reply.writer), (&b"home"[..], robot));
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn another_server_reads_no_request_and_cannot_have_it_carried_out_again() -> Result<()> {
    let mut service = Service::beside(NameRole::Server).await?;
    let (robot, from) = (service.server_identity.name(), service.client_node.name());
    let Service { switch, owner, server, server_node, client_identity, client_node, client, other, boxes, .. } =
        &mut service;
    eventually("the client to know both servers", || (client.servers() == 2).then_some(()))?;
    let (reply, ()) = tokio::try_join!(
        async { Ok(timeout(TIMEOUT, client.call_at(robot, Encoding::Bytes, b"where to?")).await??) },
        async {
            let call = timeout(TIMEOUT, server.recv()).await?.context("a call")?;
            anyhow::Ok(call.reply(Encoding::Bytes, b"home").await?)
        },
    )?;
    assert_eq!(reply.writer, robot);
    let mut seen = Vec::new();
    eventually("the request to come to the other server as well", || {
        seen.extend(other.listen(switch));
        of(&seen, robot, from).next().is_some().then_some(())
    })?;
    assert!(seen.iter().all(|frame| frame.destination != owner.name()), "nothing goes to the service itself");
    assert!(other.read(robot, client_identity, &seen)?.is_empty());
    // The rogue has a key for what the client would send to it; the others' boxes from a RIB are
    // useless to it.
    let key = client_identity.key().verify_key();
    let stored = boxes.lock().unwrap().clone();
    let of_client = stored.iter().filter_map(|signed| Some((signed, signed.claims_unverified().ok()?)));
    let of_client: Vec<_> = of_client.filter(|(_, claims)| claims.writer == from && claims.name == robot).collect();
    assert!(!of_client.is_empty());
    for (signed, claims) in of_client {
        assert_eq!(claims.reader, robot);
        for reader in [robot, other.name()] {
            let opened = keys::open(signed, robot, (from, &key), (reader, other.identity.box_key()));
            assert!(opened.is_err());
        }
    }

    // The server executes recorded requests once, however often the rogue repeats them. It never
    // executes a request that the rogue seals itself.
    let recorded: Vec<Frame> = of(&seen, robot, from).cloned().collect();
    let before = server_node.counters().messages_received;
    switch.inject(&recorded);
    drops(server_node, "seal_duplicate", 1)?;
    let mut writer = Writer::new(robot, from, other.identity.key().clone(), Backend::selected())?;
    writer.set_epoch(1, &EpochKey::generate()?)?;
    let (mut segments, draft) =
        (Segments::new(), Draft { service: Some(owner.name()), ..Draft::new(Encoding::Bytes, b"elsewhere") });
    writer.seal_batch(0, &[draft], 1000, &mut segments)?;
    switch.inject(&frames(&segments, robot, from, robot));
    drops(server_node, "seal_no_key", 1)?;
    assert_eq!(server_node.counters().messages_received, before);
    assert!(client_node.counters().messages_received > 0);
    Ok(())
}

/// A server and a client, and a second entity with the same right as one of them.
struct Service {
    client: Client,
    server: Server,
    client_node: Node,
    server_node: Node,
    client_identity: Identity,
    server_identity: Identity,
    other: Rogue,
    owner: Owner,
    /// All boxes that writers stored at the RIB.
    boxes: Arc<Mutex<Vec<Signed<KeyBox>>>>,
    switch: Switch,
}

impl Service {
    async fn start() -> Result<Self> {
        Self::beside(NameRole::Caller).await
    }

    /// Builds the service. `role`: the second entity's role.
    async fn beside(role: NameRole) -> Result<Self> {
        let (switch, owner) = (Switch::start()?, Owner::new("/plan")?);
        let (server_identity, client_identity) = (Identity::generate("proxy")?, Identity::generate("proxy")?);
        let boxes: Arc<Mutex<Vec<Signed<KeyBox>>>> = Arc::default();
        let adding = boxes.clone();
        switch.refuse_to_hear(move |request| {
            if let EntityRequest::KeyBoxes { boxes } = request {
                adding.lock().unwrap().extend_from_slice(boxes);
            }
            false
        });
        let mut other = Rogue::attach(&switch)?;
        let to = other.name();
        switch.tamper(move |frames| frames.iter_mut().for_each(|frame| frame.to.push(to)));
        let (server_node, client_node) =
            (node(&switch, &server_identity).await?, node(&switch, &client_identity).await?);
        let proof = owner.card.proof();
        let server = server_node.serve(proof, owner.ad_cert(server_node.name())?).await?;
        let client = client_node.client(proof, owner.grant(client_node.name())?).await?;
        let stated = other.state(&switch, &owner, role)?;
        assert!(matches!(stated, Response::Peers(_)), "{stated:?}");
        Ok(Self {
            client,
            server,
            client_node,
            server_node,
            client_identity,
            server_identity,
            other,
            owner,
            boxes,
            switch,
        })
    }
}

/// Returns the sealed frames in one direction.
fn of(frames: &[Frame], to: Name, from: Name) -> impl Iterator<Item = &Frame> {
    frames
        .iter()
        .filter(move |frame| (frame.destination, frame.source) == (to, from) && frame.payload.first() == Some(&SEGMENT))
}

fn contains(frame: &Frame, text: &[u8]) -> bool {
    frame.payload.windows(text.len()).any(|window| window == text)
}

/// Returns the id of the message in a frame's first segment: docs/wire-format.md, "Sealed
/// segments".
fn message_id(frame: &Frame) -> MessageId {
    let (mut session, mut sequence) = ([0; 16], [0; 8]);
    session.copy_from_slice(&frame.payload[16..32]);
    sequence[2..].copy_from_slice(&frame.payload[8..14]);
    MessageId { session, sequence: u64::from_be_bytes(sequence) }
}
