//! A RIB that lies. It can withhold information from entities. It cannot make them believe what the
//! owner of a name has not signed.

use std::sync::{Arc, Mutex};

use anyhow::Result;
use gdp::unstable::{PublishOptions, SubscribeOptions};
use gdp_core::cert::Signed;
use gdp_core::crypto::Backend;
use gdp_core::identity::Identity;
use gdp_core::keys::{self, EpochKey, KeyBox};
use gdp_e2e::seal::{Encoding, Writer};
use gdp_proto::control::{Credential, EntityRequest, NameRole, Response};
use gdp_wire::Name;

use crate::evil::{Frame, Owner, Recording, Rogue, Scene, Switch, drops, eventually, node, serial};
use gdp_tests::wait::TIMEOUT;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_has_no_certificate_of_the_owner_is_not_believed_to_write() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let Scene { switch, owner, cloud, .. } = &scene;
    let (mut rogue, name) = (Rogue::attach(switch)?, owner.name());
    let other = Identity::generate("proxy")?.name();
    let mut rights = vec![
        ("signed by another key", Credential::Writer(owner.impostor()?.ad_cert(rogue.name())?)),
        ("of another entity", Credential::Writer(owner.ad_cert(other)?)),
        ("of another name", Credential::Writer(Owner::new("/chatter")?.ad_cert(rogue.name())?)),
        ("to read", Credential::Reader(owner.grant(rogue.name())?)),
    ];
    for (what, right) in rights.drain(..) {
        let record = rogue.record(switch, owner, NameRole::Publisher, right)?;
        // The update also contains the honest records: the cloud refuses only the lie.
        let records = [vec![record], writers(switch, name)].concat();
        let told = switch.tell(cloud.name(), (name, NameRole::Subscriber), records, None, vec![]).await?;
        assert!(matches!(told, Response::Done), "{what}: {told:?}");
        let before = cloud.counters().drops.get("seal_unknown_writer").copied().unwrap_or(0);
        switch.inject(&forged(&rogue, owner, cloud.name())?);
        drops(cloud, "seal_unknown_writer", before + 1)?;
    }
    scene.passes(b"true").await
}

fn writers(switch: &Switch, name: Name) -> Vec<gdp_proto::control::Record> {
    switch.records().into_iter().filter(|record| record.name == name && record.is_writer()).collect()
}

/// Seals a message of the rogue under its own key.
fn forged(rogue: &Rogue, owner: &Owner, to: Name) -> Result<Vec<Frame>> {
    let mut writer = Writer::new(owner.name(), rogue.name(), rogue.identity.key().clone(), Backend::selected())?;
    writer.set_epoch(1, &EpochKey::generate()?)?;
    rogue.sealed(&mut writer, rogue.name(), b"forged", to)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn no_key_is_wrapped_for_who_has_no_grant_of_the_owner() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let Scene { switch, owner, robot, .. } = &scene;
    let (mut rogue, name) = (Rogue::attach(switch)?, owner.name());
    let boxes = Boxes::of(switch);
    let other = Identity::generate("proxy")?.name();
    for right in [
        Credential::Reader(owner.impostor()?.grant(rogue.name())?),
        Credential::Reader(owner.grant(other)?),
        Credential::Reader(Owner::new("/chatter")?.grant(rogue.name())?),
        Credential::Writer(owner.ad_cert(rogue.name())?),
    ] {
        let record = rogue.record(switch, owner, NameRole::Subscriber, right)?;
        let readers = switch.records().into_iter().filter(|record| record.name == name && !record.is_writer());
        let records = readers.chain([record]).collect();
        let told = switch.tell(robot.name(), (name, NameRole::Publisher), records, None, vec![]).await?;
        assert!(matches!(told, Response::Done), "{told:?}");
    }
    // An honest reader joins later and gets its box; the others would have theirs by then.
    let mut late = Rogue::attach(switch)?;
    assert!(matches!(late.state(switch, owner, NameRole::Subscriber)?, Response::Peers(_)));
    eventually("a box for the late reader", || boxes.readers().contains(&late.name()).then_some(()))?;
    assert!(!boxes.readers().contains(&rogue.name()));
    scene.passes(b"true").await
}

/// The boxes that writers bring to the RIB, which receives no revocation from now on.
struct Boxes(Arc<Mutex<Vec<Signed<KeyBox>>>>);

impl Boxes {
    fn of(switch: &Switch) -> Self {
        let boxes: Arc<Mutex<Vec<_>>> = Arc::default();
        let adding = boxes.clone();
        switch.refuse_to_hear(move |request| {
            if let EntityRequest::KeyBoxes { boxes } = request {
                adding.lock().unwrap().extend_from_slice(boxes);
            }
            matches!(request, EntityRequest::Revoke { .. })
        });
        Self(boxes)
    }

    fn all(&self) -> Vec<KeyBox> {
        self.0.lock().unwrap().iter().filter_map(|signed| signed.claims_unverified().ok()).collect()
    }

    fn readers(&self) -> Vec<Name> {
        self.all().iter().map(|claims| claims.reader).collect()
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn boxes_of_others_are_not_opened() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let Scene { switch, owner, cloud, cloud_identity, robot, .. } = &scene;
    let (rogue, name) = (Rogue::attach(switch)?, owner.name());
    let (key, reader) = (EpochKey::generate()?, (cloud.name(), &cloud_identity.box_public()));
    // One box signed by the rogue, which is no writer; one in the robot's name, with the rogue's
    // own signature.
    let own = keys::wrap(name, &rogue.identity, reader, u32::MAX, &key)?;
    let claims = KeyBox { writer: robot.name(), ..own.claims_unverified()? };
    let in_its_name = gdp_core::cert::issue(rogue.identity.key(), &claims)?;
    let told = switch
        .tell(cloud.name(), (name, NameRole::Subscriber), writers(switch, name), None, vec![own, in_its_name])
        .await?;
    assert!(matches!(told, Response::Done), "{told:?}");
    let mut writer = Writer::new(name, robot.name(), rogue.identity.key().clone(), Backend::selected())?;
    writer.set_epoch(u32::MAX, &key)?;
    switch.inject(&rogue.sealed(&mut writer, robot.name(), b"forged", cloud.name())?);
    // The cloud did not accept the key in the box.
    scene.drops("seal_no_key", 1)?;
    scene.passes(b"true").await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_revocation_that_was_heard_is_never_taken_back() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let Scene { switch, owner, robot, .. } = &scene;
    let name = owner.name();
    let mut rogue = Rogue::attach(switch)?;
    let grant = owner.grant(rogue.name())?;
    let right = Credential::Reader(grant.clone());
    let stated = rogue.state_with(switch, owner, NameRole::Subscriber, right.clone())?;
    assert!(matches!(stated, Response::Peers(_)), "{stated:?}");
    rogue.await_key(switch, name, &scene.robot_identity)?;
    let harmless = owner.revocation(vec![1])?;
    let revoked = owner.revocation(vec![serial(grant.grant.serials())?])?;
    let boxes = Boxes::of(switch);
    assert!(matches!(revoke(switch, owner, &revoked), Response::Done));
    eventually("another epoch without the rogue", || (!boxes.all().is_empty()).then_some(()))?;

    // The RIB forgets the revocation, sends the older one, and lists the rogue as a reader.
    let readers = switch.records().into_iter().filter(|record| record.name == name && !record.is_writer());
    let records = readers.chain([rogue.record(switch, owner, NameRole::Subscriber, right.clone())?]).collect();
    let told = switch.tell(robot.name(), (name, NameRole::Publisher), records, Some(harmless), vec![]).await?;
    assert!(matches!(told, Response::Done), "{told:?}");
    // Or the RIB restarts without the revocation, so the rogue may state its role again.
    switch.restart_rib();
    eventually("both to be there again", || {
        (switch.records().iter().filter(|record| record.name == name).count() == 2).then_some(())
    })?;
    let mut rogue_again = rogue.again(switch)?;
    let stated = rogue_again.state_with(switch, owner, NameRole::Subscriber, right)?;
    assert!(matches!(stated, Response::Peers(_)), "this RIB knows of no revocation: {stated:?}");
    let mut late = Rogue::attach(switch)?;
    late.state(switch, owner, NameRole::Subscriber)?;
    eventually("a box for the late reader", || boxes.readers().contains(&late.name()).then_some(()))?;
    assert!(!boxes.readers().contains(&rogue.name()));
    scene.passes(b"true").await
}

pub fn revoke(switch: &Switch, owner: &Owner, revocation: &Signed<gdp_core::cert::Revocation>) -> Response {
    let request = EntityRequest::Revoke { proof: owner.card.proof(), revocation: revocation.clone() };
    switch.ask(None, &request)
}

/// A RIB can only withhold a revocation. An entity that never receives it accepts the certificate
/// until it expires. The revocation takes effect once it reaches the entity on another path, or
/// through another RIB.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_revocation_that_is_withheld_holds_once_it_is_heard() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let Scene { switch, owner, cloud, .. } = &scene;
    let record = writers(switch, owner.name()).remove(0);
    let revocation = owner.revocation(vec![serial(record.credential.serials())?])?;
    // The RIB still lists the robot as a writer, next to the revocation of its right.
    let told = (owner.name(), NameRole::Subscriber);
    switch.tell(cloud.name(), told, vec![record], Some(revocation), vec![]).await?;
    let _ = scene.publisher.send(Encoding::Bytes, b"revoked").await;
    scene.drops("seal_unknown_writer", 1)?;
    assert!(scene.delivered().await.is_empty());
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_rib_that_withholds_a_key_withholds_what_is_said_and_no_more() -> Result<()> {
    let mut scene = Scene::reliable().await?;
    let (name, cloud) = (scene.owner.name(), scene.cloud.name());
    scene.switch.lie(move |entity, about, _, peers| {
        if (entity, about) == (cloud, name) {
            peers.boxes.clear();
        }
    });
    // Another robot, whose key the cloud does not receive.
    let robot = node(&scene.switch, &Identity::generate("proxy")?).await?;
    let mut publisher = scene.owner.publish(&robot, PublishOptions::reliable()).await?;
    publisher.send(Encoding::Bytes, b"unread").await?;
    scene.drops("seal_no_key", 1)?;
    scene.passes(b"from the robot whose key it has").await?;
    // After the key arrives, nothing is lost.
    scene.switch.lie(|_, _, _, _| {});
    scene.switch.restart_rib();
    assert_eq!(&scene.next().await?.body[..], b"unread");
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_name_that_is_pointed_at_another_entity_gives_it_nothing_to_read() -> Result<()> {
    let mut scene = Scene::best_effort().await?;
    let rogue = Rogue::attach(&scene.switch)?;
    let (name, to) = (scene.owner.name(), rogue.name());
    let recording = Recording::default();
    let adding = recording.clone();
    scene.switch.tamper(move |frames| {
        frames.iter_mut().filter(|frame| frame.destination == name).for_each(|frame| frame.to = vec![to]);
        adding.add(frames);
    });
    scene.send(b"secret").await?;
    eventually("the frame to come to the rogue", || {
        recording.frames().iter().any(|frame| frame.destination == name).then_some(())
    })?;
    let messages = rogue.read(name, &scene.robot_identity, &recording.frames())?;
    assert!(messages.is_empty() && rogue.keys(name, &scene.robot_identity).is_empty());
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_rib_that_starts_anew_stops_nothing_that_runs() -> Result<()> {
    let mut scene = Scene::reliable().await?;
    scene.switch.restart_rib();
    let name = scene.owner.name();
    eventually("both to be there again", || {
        (scene.switch.records().iter().filter(|record| record.name == name).count() == 2).then_some(())
    })?;
    scene.passes(b"true").await?;
    let reader = node(&scene.switch, &Identity::generate("proxy")?).await?;
    let mut again = scene.owner.subscribe(&reader, SubscribeOptions::reliable()).await?;
    // A reader begins with the first message after the writer knows of it.
    eventually("the robot to know both", || (scene.publisher.readers() == 2).then_some(()))?;
    scene.publisher.send(Encoding::Bytes, b"to both").await?;
    let message = tokio::time::timeout(TIMEOUT, again.recv()).await?;
    assert_eq!(message.map(|message| message.body).as_deref(), Some(&b"to both"[..]));
    Ok(())
}
