//! What the RIB tells of those on the other side of this node's names, and the key boxes that follow: to the publications, to the
//! receiving thread, and back to the RIB.

use std::sync::Arc;
use std::time::Duration;

use gdp_wire::Name;

use super::NodeError;
use super::clock::{unix_nanos, unix_now};
use super::publication::Publication;
use super::reading::Effect;
use super::receiver::Command;
use super::state::{State, ask, lock};
use super::supervisor::{Attachment, Event};
use crate::cert::CertError;
use crate::control::{EntityRequest, NameRole, Peers, Response};
use crate::peers::{OutOfStep, PeerEvent};

/// How often it is looked for what has ended.
const LOOK: Duration = Duration::from_secs(1);

impl State {
    /// Takes what the RIB told of the counterparts in a name; `None` if this node has no such part in it.
    pub fn take_peers(&self, name: Name, role: NameRole, peers: &Peers) -> Option<Result<(), OutOfStep>> {
        // Held throughout, so that what follows comes in the order in which it was told.
        let mut all = lock(&self.counterparts);
        let counterparts = all.get_mut(&(name, role))?;
        match counterparts.take(unix_now(), peers) {
            Ok(events) => {
                for event in &events {
                    if let PeerEvent::RibIsBehind(revocation) = event {
                        let (proof, revocation) = (*counterparts.proof(), revocation.clone());
                        let _ = self.events.send(Event::Revoke { proof, revocation });
                    }
                }
                self.act(name, role, events);
                Some(Ok(()))
            }
            Err(error) => Some(Err(error)),
        }
    }

    fn act(&self, name: Name, role: NameRole, events: Vec<PeerEvent>) {
        if let Some(PeerEvent::Revoked(revocation)) = events.iter().find(|event| matches!(event, PeerEvent::Revoked(_)))
            && let Err(error) = self.check_own(name, role, revocation)
        {
            self.end(name, role, error);
        }
        match role {
            NameRole::Publisher => {
                if let Some(publication) = lock(&self.publications).get(&name) {
                    publication.take(&self.outlet, unix_now(), events);
                    self.outlet.upkeep.notify_one();
                }
            }
            NameRole::Subscriber => {
                let effects = lock(&self.readings).get_mut(&name).map(|reading| reading.take(unix_nanos(), events));
                self.carry_out(name, effects.unwrap_or_default());
            }
            NameRole::Server | NameRole::Caller => {}
        }
    }

    /// This node's own right in a name has been revoked.
    fn end(&self, name: Name, role: NameRole, error: CertError) {
        tracing::warn!(%name, %error, "the owner has revoked the right of this node as a {role}");
        match role {
            NameRole::Publisher => {
                if let Some(publication) = lock(&self.publications).get(&name) {
                    publication.end(error);
                }
            }
            NameRole::Subscriber => {
                if let Some(ended) = lock(&self.subscriptions).get(&name) {
                    let _ = ended.set(error);
                }
                self.command(Command::Unsubscribe { name });
            }
            NameRole::Server | NameRole::Caller => {}
        }
    }

    pub(super) fn carry_out(&self, name: Name, effects: Vec<Effect>) {
        let mut changes = Vec::new();
        for effect in effects {
            match effect {
                Effect::Change(change) => changes.push(change),
                Effect::Introduce(writer, box_key) => lock(&self.outlet.pairs).introduce(writer, box_key),
                Effect::Part(writer) => lock(&self.outlet.pairs).part(&writer),
            }
        }
        if !changes.is_empty() {
            self.command(Command::Change { name, changes });
        }
    }

    /// Runs as long as the node: ends what has ended, sends latched messages to readers that came, and has the RIB store boxes as
    /// soon as there are any.
    pub async fn keep(&self) {
        loop {
            self.expire();
            let publications: Vec<_> = lock(&self.publications).values().cloned().collect();
            publications.iter().for_each(|publication| publication.latch(&self.outlet));
            if let Ok(attachment) = self.attached_now() {
                for publication in &publications {
                    self.store_boxes(&attachment, publication).await;
                }
            }
            let next = publications.iter().map(|publication| publication.boxes_at()).min().unwrap_or(u64::MAX);
            let pause = Duration::from_nanos(next.saturating_sub(unix_nanos())).clamp(LOOK / 20, LOOK);
            tokio::select! {
                () = self.outlet.upkeep.notified() => {}
                () = tokio::time::sleep(pause) => {}
            }
        }
    }

    fn expire(&self) {
        let now = unix_now();
        {
            let mut counterparts = lock(&self.counterparts);
            for ((name, role), known) in counterparts.iter_mut() {
                let events = known.expire(now);
                if !events.is_empty() {
                    self.act(*name, *role, events);
                }
            }
        }
        lock(&self.publications).values().for_each(|publication| publication.expire(&self.outlet, now));
        let mut ended = Vec::new();
        for (name, reading) in lock(&self.readings).iter_mut() {
            ended.push((*name, reading.expire(unix_nanos())));
        }
        ended.into_iter().for_each(|(name, effects)| self.carry_out(name, effects));
    }

    /// Brings the boxes of a publication to the RIB, as far as there are any.
    pub async fn store_boxes(&self, attachment: &Attachment, publication: &Arc<Publication>) {
        let _turn = publication.boxing.lock().await;
        loop {
            let boxes = match publication.boxes() {
                Ok(Some(boxes)) => boxes,
                Ok(None) => return,
                Err(error) => {
                    return tracing::error!(name = %publication.name, %error, "no keys for readers");
                }
            };
            let request = EntityRequest::KeyBoxes { boxes: boxes.boxes.clone() };
            let stored = match ask(attachment, request).await {
                Ok(Response::Done) => Ok(boxes.epoch),
                Ok(_) => Err(NodeError::Protocol("to key boxes")),
                Err(error) => Err(error),
            };
            match stored {
                Ok(epoch) => publication.boxes_stored(Ok(epoch)),
                // Offered again before long.
                Err(error) => {
                    tracing::debug!(name = %publication.name, %error, "key boxes could not be stored");
                    return publication.boxes_stored(Err(boxes));
                }
            }
        }
    }
}
