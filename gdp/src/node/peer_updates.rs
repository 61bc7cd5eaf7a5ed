//! Distributes the RIB's updates about counterparts, and the resulting key boxes.
//!
//! Updates go to the publications and the receiving thread, key boxes back to the RIB.

use std::sync::Arc;
use std::time::Duration;

use gdp_wire::Name;
use tokio::sync::Notify;
use tokio::time::Instant;

use super::attachment::Attachment;
use super::command::{Command, RibUpdate};
use super::error::NodeError;
use super::publication::Publication;
use super::reading::{Effect, Reading};
use super::registration::ask;
use super::state::State;
use gdp_core::cert::Revocation;
use gdp_proto::control::{EntityRequest, NameRole, Peers, RefusalCode, Response};
use gdp_proto::peers::{OutOfStep, PeerEvent};
use gdp_util::unix_time::{unix_nanos, unix_seconds};

/// Interval of the checks for expired rights.
const LOOK: Duration = Duration::from_secs(1);

impl State {
    /// Processes the RIB's update about the counterparts in a name. Returns `None` if this node
    /// does not have that role in the name.
    pub fn take_peers(&self, name: Name, role: NameRole, peers: &Peers) -> Option<Result<(), OutOfStep>> {
        if name == self.identity.name() && role == NameRole::Subscriber {
            return self.take_boxes(peers);
        }
        // Locked throughout, to preserve the order of the updates.
        let mut all = self.counterparts.lock();
        let counterparts = all.get_mut(&(name, role))?;
        match counterparts.take(unix_seconds(), peers) {
            Ok(events) => {
                for event in &events {
                    let proof = *counterparts.proof();
                    match event {
                        PeerEvent::RibIsBehind(revocation) => {
                            let revocation = revocation.clone();
                            let _ = self.rib_updates.send(RibUpdate::Revoke { proof, revocation });
                        }
                        PeerEvent::Revoked(claims) => {
                            let signed = counterparts.signed_revocation().cloned();
                            signed.into_iter().for_each(|signed| self.revoked.keep(proof, signed, claims.clone()));
                            self.send_path.upkeep.notify_one();
                        }
                        _ => {}
                    }
                }
                self.act(name, role, events);
                Some(Ok(()))
            }
            Err(error) => Some(Err(error)),
        }
    }

    /// Processes a revocation by a domain.
    pub fn domain_revoked(&self, claims: &Revocation) {
        // Locked as in `take_peers`.
        let mut all = self.counterparts.lock();
        for ((name, role), counterparts) in all.iter_mut() {
            let events = counterparts.domain_revoked(claims);
            if !events.is_empty() {
                self.act(*name, *role, events);
            }
        }
        self.sweep_instances();
    }

    fn act(&self, name: Name, role: NameRole, events: Vec<PeerEvent>) {
        if let Some(PeerEvent::Revoked(revocation)) = events.iter().find(|event| matches!(event, PeerEvent::Revoked(_)))
            && let Err(error) = self.check_own(name, role, revocation)
        {
            self.end(name, role, error);
        }
        match role {
            NameRole::Server | NameRole::Caller => self.take_instances(name, role, &events),
            NameRole::Publisher => {
                if let Some(publication) = self.send_path.publications.get(&name) {
                    publication.take(unix_seconds(), events);
                    self.send_path.upkeep.notify_one();
                }
            }
            NameRole::Subscriber => self.take_writers(name, events),
        }
    }

    pub(super) fn take_writers(&self, name: Name, events: Vec<PeerEvent>) {
        self.change_reading(name, |reading| reading.take(unix_nanos(), events));
    }

    /// Applies the effects before the next change of the reading. The receiving thread cannot use
    /// keys of a writer that it does not know yet.
    pub(super) fn change_reading(&self, name: Name, change: impl FnOnce(&mut Reading) -> Vec<Effect>) {
        if let Some(reading) = self.readings.lock().get_mut(&name) {
            self.carry_out(name, change(reading));
        }
    }

    /// Processes key boxes for this node's own name. They are verified like those of any name.
    fn take_boxes(&self, peers: &Peers) -> Option<Result<(), OutOfStep>> {
        let own = self.identity.name();
        if !self.readings.lock().contains_key(&own) {
            return None;
        }
        self.take_writers(own, peers.boxes.iter().cloned().map(PeerEvent::KeyBox).collect());
        Some(Ok(()))
    }

    fn carry_out(&self, name: Name, effects: Vec<Effect>) {
        let mut changes = Vec::new();
        for effect in effects {
            match effect {
                Effect::Change(change) => changes.push(change),
                Effect::Introduce(writer, box_key) => self.send_path.pairs.introduce(writer, box_key),
                Effect::Part(writer) => self.send_path.pairs.part(&writer),
                Effect::Tell(writer, feedback) => self.send_path.tell(&writer, &[feedback]),
            }
        }
        if !changes.is_empty() {
            self.commands.send(Command::Change { name, changes });
        }
    }

    /// Runs for the lifetime of the node. It ends expired rights, sends latched messages to new
    /// readers, and stores key boxes with the RIB.
    pub async fn keep(self: &Arc<Self>) {
        // The RIB may answer slowly, and no other work waits for it.
        let boxes = Notify::new();
        tokio::join!(self.look(&boxes), self.store_all_boxes(&boxes));
    }

    async fn look(self: &Arc<Self>, boxes: &Notify) {
        let mut saved: Option<Instant> = None;
        loop {
            self.expire();
            if self.revoked.is_unsaved() && saved.is_none_or(|at| at.elapsed() >= LOOK) {
                saved = Some(Instant::now());
                let state = self.clone();
                let _ = tokio::task::spawn_blocking(move || state.revoked.save()).await;
            }
            let publications = self.send_path.publications.all();
            publications.iter().for_each(|publication| publication.latch());
            boxes.notify_one();
            let next = publications.iter().map(|publication| publication.sealer.boxes_at()).min().unwrap_or(u64::MAX);
            let pause = Duration::from_nanos(next.saturating_sub(unix_nanos())).clamp(LOOK / 20, LOOK);
            tokio::select! {
                () = self.send_path.upkeep.notified() => {}
                () = tokio::time::sleep(pause) => {}
            }
        }
    }

    /// Stores key boxes with the RIB. `due` is notified when there may be some.
    async fn store_all_boxes(&self, due: &Notify) {
        loop {
            due.notified().await;
            let publications = self.send_path.publications.all();
            for publication in &publications {
                if let Ok(attachment) = self.send_path.links.attached_now() {
                    self.store_boxes(&attachment, publication).await;
                }
            }
        }
    }

    fn expire(&self) {
        let now = unix_seconds();
        {
            let mut counterparts = self.counterparts.lock();
            for ((name, role), known) in counterparts.iter_mut() {
                let events = known.expire(now);
                if !events.is_empty() {
                    self.act(*name, *role, events);
                }
            }
            self.sweep_instances();
        }
        for (name, stated, error) in self.expired(now) {
            self.end(name, stated.role(), error);
        }
        self.send_path.publications.all().iter().for_each(|publication| publication.expire(now));
        for (name, reading) in self.readings.lock().iter_mut() {
            self.carry_out(*name, reading.expire(unix_nanos()));
        }
    }

    /// Stores the pending boxes of a publication with the RIB.
    pub async fn store_boxes(&self, attachment: &Attachment, publication: &Arc<Publication>) {
        let _turn = publication.boxing.lock().await;
        loop {
            let boxes = match publication.sealer.boxes() {
                Ok(Some(boxes)) => boxes,
                Ok(None) => return,
                Err(error) => {
                    return tracing::error!(name = %publication.name, %error, "no keys for readers");
                }
            };
            let statements = publication.sealer.statements();
            let request = EntityRequest::KeyBoxes { boxes: boxes.boxes.clone() };
            let error = match ask(attachment, request).await {
                Ok(Response::Done) => {
                    publication.sealer.boxes_stored(&boxes);
                    continue;
                }
                Ok(_) => NodeError::Protocol("to key boxes"),
                Err(error) => error,
            };
            if !error.may_pass() {
                tracing::warn!(name = %publication.name, %error, "the RIB does not take keys for readers");
                publication.sealer.boxes_refused(statements);
            } else {
                tracing::debug!(name = %publication.name, %error, "key boxes could not be stored");
                let no_room = matches!(&error, NodeError::Refused(refusal) if refusal.code == RefusalCode::Limit);
                publication.sealer.boxes_failed(boxes, no_room);
            }
            return;
        }
    }
}
