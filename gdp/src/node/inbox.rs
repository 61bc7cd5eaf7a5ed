//! The messages to this node's own name: requests to its services and replies to its calls.
//!
//! Also the return paths to their senders. Each party of a service has one publication to its own
//! name. That publication carries requests and replies of all services.

use std::collections::BTreeSet;
use std::sync::Arc;

use gdp_wire::Name;
use tokio::sync::watch;

use super::ending::Ended;
use super::error::NodeError;
use super::options::{PublishOptions, SubscribeOptions};
use super::service::{Service, Services};
use super::service_instances::{Instance, PendingCall, joint_right};
use super::state::State;
use super::statement::Stated;
use gdp_e2e::seal::Message;
use gdp_proto::control::{NameRole, PathCosts};
use gdp_proto::peers::{Counterpart, PeerEvent};
use gdp_util::unix_time::unix_seconds;

impl State {
    /// Starts to receive requests and replies, until the node closes.
    pub fn open_inbox(self: &Arc<Self>) {
        let own = self.identity.name();
        let mut opened = self.inbox_opened.lock();
        if std::mem::replace(&mut *opened, true) {
            return;
        }
        let (mut queue, _) = self.listen(own, SubscribeOptions::reliable());
        let state = self.clone();
        tokio::spawn(async move {
            while let Some(message) = queue.recv().await {
                match message.service {
                    Some(service) => state.take_request(service, message),
                    None => state.take_reply(message),
                }
            }
            // The remaining callers get no reply.
            state.calls.lock().clear();
        });
    }

    /// Accepts a request if its writer may call the service, as certified by the service's owner.
    /// The request may arrive before the RIB has announced that right: the two parties may already
    /// share keys for another service.
    fn take_request(&self, service: Name, request: Message) {
        let now = self.send_path.clock.now();
        let mut services = self.services.lock();
        let served = services.get_mut(&(service, NameRole::Server));
        let Some(Service { instances, tray: Some(tray), .. }) = served else {
            return self.counters.requests_refused.add(1);
        };
        if instances.right(&request.writer).is_none() {
            let dropped = tray.defer(now, request);
            self.counters.requests_refused.add(dropped as u64);
        } else if !tray.put(request) {
            self.counters.queue_full.add(1);
        }
    }

    /// Accepts a reply once, and only from the server that was called.
    fn take_reply(&self, reply: Message) {
        let Some(id) = reply.in_reply_to else { return };
        let mut calls = self.calls.lock();
        if calls.get(&id).is_some_and(|pending| pending.instance == reply.writer)
            && let Some(pending) = calls.remove(&id)
        {
            let _ = pending.reply.send(reply);
        }
    }

    /// Processes changes of a service's callers or servers. Call with [`State::counterparts`]
    /// locked, as for all functions that change instances.
    pub(super) fn take_instances(&self, name: Name, role: NameRole, events: &[PeerEvent]) {
        {
            // Locked until the end: a message sent before the publication exists would reach no
            // reader. No server without a publication must be selected.
            let (now, mut services) = (self.send_path.clock.now(), self.services.lock());
            let joined = events.iter().filter_map(|event| match event {
                PeerEvent::Joined(right) => Some(right.entity),
                _ => None,
            });
            let is_here = |entity: &Name| services.values().any(|service| service.instances.is_attached(entity));
            let returned: BTreeSet<Name> = joined.filter(|entity| !is_here(entity)).collect();
            let Some(Service { instances, .. }) = services.get_mut(&(name, role)) else { return };
            let mut concerned = instances.take(now, &name, events);
            concerned.extend(instances.sweep(now, unix_seconds()));
            self.settle(&services, concerned, &returned);
        }
        // Run now that the return paths exist.
        self.release_requests();
    }

    /// Removes instances that have expired. Locking as for [`Self::take_instances`].
    pub(super) fn sweep_instances(&self) {
        let (now, now_unix) = (self.send_path.clock.now(), unix_seconds());
        {
            let mut services = self.services.lock();
            let gone = services.values_mut().flat_map(|service| service.instances.sweep(now, now_unix)).collect();
            self.settle(&services, gone, &BTreeSet::new());
        }
        self.release_requests();
    }

    /// Ends calling or serving by this statement. Locking as for [`Self::take_instances`].
    pub(super) fn end_service(&self, name: Name, stated: Stated, why: Ended) {
        let mut services = self.services.lock();
        if let Some(mut service) = services.remove(&(name, stated.role())) {
            service.end(why);
            self.settle(&services, service.instances.clear(self.send_path.clock.now()), &BTreeSet::new());
        }
    }

    /// Aligns the publications to these entities, and the writers of the inbox, with their
    /// services. `returned` has the entities that were attached for none of the services before.
    fn settle(&self, services: &Services, entities: BTreeSet<Name>, returned: &BTreeSet<Name>) {
        if entities.is_empty() {
            return;
        }
        for entity in entities {
            match joint_right(services.values().filter_map(|service| service.instances.right(&entity))) {
                Some(right) => self.open_way(right, returned.contains(&entity)),
                None => self.close_way(entity),
            }
        }
        self.send_path.upkeep.notify_one();
    }

    fn open_way(&self, right: Counterpart, returned: bool) {
        let (entity, own) = (right.entity, self.identity.name());
        let joined = PeerEvent::Joined(right);
        let known = self.send_path.publications.get(&entity);
        match known {
            Some(publication) => {
                if returned {
                    // The RIB has removed the key boxes of a pair that had disconnected.
                    publication.sealer.store_again();
                    publication.returned(&entity);
                }
                publication.take(unix_seconds(), [joined.clone()]);
            }
            None => match self.publication(entity, &PublishOptions::reliable()) {
                Ok(publication) => {
                    // Run before any task can send to it.
                    publication.take(unix_seconds(), [joined.clone()]);
                    self.send_path.publications.insert(Arc::new(publication));
                }
                Err(error) => return tracing::error!(party = %entity, %error, "nothing can be sent to it"),
            },
        }
        self.take_writers(own, vec![joined]);
    }

    fn close_way(&self, entity: Name) {
        self.change_reading(self.identity.name(), |reading| reading.forget(&entity));
        // Statements may be examined with services locked only if counterparts are locked as well.
        // `begin` takes the two locks in the opposite order.
        if !self.is_stated(entity, Stated::Published) {
            self.send_path.close(&entity);
        }
    }

    fn release_requests(&self) {
        let now = self.send_path.clock.now();
        for Service { instances, tray, .. } in self.services.lock().values_mut() {
            let Some(tray) = tray else { continue };
            let (released, late) = tray.release(now, |caller| instances.right(caller).is_some());
            self.counters.requests_refused.add(late as u64);
            let full = released.into_iter().filter(|request| !tray.put(request.clone())).count();
            self.counters.queue_full.add(full as u64);
        }
    }

    /// Reserves a call at a server of the service: at `one`, or at the preferred server.
    pub(super) fn choose(&self, service: Name, one: Option<&Name>) -> Option<PendingCall> {
        let costs = self.costs();
        self.services
            .lock()
            .get(&(service, NameRole::Caller))?
            .instances
            .choose(one, |switch| costs.get(switch).copied())
    }

    pub(super) fn instances(&self, service: Name) -> Vec<Instance> {
        let (costs, services) = (self.costs(), self.services.lock());
        let called = services.get(&(service, NameRole::Caller));
        called.map_or_else(Vec::new, |called| called.instances.instances(|switch| costs.get(switch).copied()))
    }

    pub(super) fn server_changes(&self, service: Name) -> watch::Receiver<()> {
        let services = self.services.lock();
        let called = services.get(&(service, NameRole::Caller));
        // A service that is not called does not change.
        called.map_or_else(|| watch::channel(()).1, |called| called.instances.changes())
    }

    pub(super) fn servers(&self, service: Name) -> usize {
        self.services.lock().get(&(service, NameRole::Caller)).map_or(0, |called| called.instances.attached_count())
    }

    /// Stores the key boxes for the preferred server with the RIB. That server then has the keys
    /// before the first call.
    pub(super) async fn store_first_boxes(&self, service: Name) -> Result<(), NodeError> {
        let first = self.instances(service).first().map(|instance| instance.name);
        let publication = first.and_then(|first| self.send_path.publications.get(&first));
        if let Some(publication) = publication {
            self.store_boxes(&*self.send_path.links.attached().await?, &publication).await;
        }
        Ok(())
    }

    /// Returns the latest path costs from the switch of the main link.
    fn costs(&self) -> Arc<PathCosts> {
        let main = self.send_path.links.main();
        self.costs.lock().get(main).cloned().unwrap_or_default()
    }

    /// Sets the path costs that a link's switch has reported.
    pub(super) fn set_costs(&self, lane: u8, costs: PathCosts) {
        if let Some(known) = self.costs.lock().get_mut(usize::from(lane)) {
            *known = Arc::new(costs);
        }
    }
}
