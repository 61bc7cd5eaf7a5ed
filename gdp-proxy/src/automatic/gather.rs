//! The plans of routes as they come together: each place and each name once, as many as a proxy has, with rights that stay up to date.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use gdp::Name;
use tokio::sync::watch;

use crate::config::{MAX_ROUTES, Side};
use crate::manager::Plan;
use crate::material::Permission;
use crate::renewal::{Renewal, Told};
use crate::ros2::TopicName;
use crate::routes::RoutePlan;

/// What is kept from one time to the next.
#[derive(Default)]
pub struct Kept {
    /// The rights to names that were made or learnt here; routes follow them by themselves.
    rights: BTreeMap<(Name, Side), watch::Sender<Permission>>,
    /// What has been said in the log: once, and not whenever a graph changes.
    pub told: BTreeSet<(TopicName, String)>,
}

/// One time.
pub struct Gathering<'a> {
    kept: &'a mut Kept,
    pub routes: Vec<Arc<RoutePlan>>,
    places: BTreeSet<<Arc<RoutePlan> as Plan>::Place>,
    /// Of which topic each name is: a node publishes a name once and subscribes to it once.
    names: BTreeMap<(Name, Side), TopicName>,
    used: BTreeSet<(Name, Side)>,
    told: BTreeSet<(TopicName, String)>,
}

impl<'a> Gathering<'a> {
    /// These go first.
    pub fn new(kept: &'a mut Kept, routes: Vec<Arc<RoutePlan>>) -> Self {
        let places = routes.iter().map(Plan::place).collect();
        let names = routes.iter().map(|plan| (named(plan), plan.config.topic.clone())).collect();
        Self { kept, routes, places, names, used: BTreeSet::new(), told: BTreeSet::new() }
    }

    /// The right to a name, as it is told to whoever uses it from now on.
    pub fn right(&mut self, name: Name, permission: Permission) -> (Permission, Renewal) {
        let side = permission.side();
        self.used.insert((name, side));
        let sender = self.kept.rights.entry((name, side)).or_insert_with(|| watch::Sender::new(permission.clone()));
        sender.send_if_modified(|known| {
            let is_new = *known != permission;
            if is_new {
                *known = permission.clone();
            }
            is_new
        });
        (permission, Renewal::Told(Told::new(sender.subscribe())))
    }

    /// Whether it is to run: another may have its place.
    pub fn add(&mut self, plan: RoutePlan) -> bool {
        let plan = Arc::new(plan);
        if self.routes.len() >= MAX_ROUTES {
            self.tell(&plan.config.topic, format!("there are {MAX_ROUTES} routes already; run a second proxy"));
            return false;
        }
        if self.places.contains(&plan.place()) {
            return false;
        }
        if let Some(other) = self.names.get(&named(&plan)) {
            let why =
                format!("its name {:#} is already that of {other}, in the same direction", plan.material.card.name());
            self.tell(&plan.config.topic, why);
            return false;
        }
        self.places.insert(plan.place());
        self.names.insert(named(&plan), plan.config.topic.clone());
        self.routes.push(plan);
        true
    }

    /// Says why a topic is not carried.
    pub fn tell(&mut self, topic: &TopicName, why: String) {
        let complaint = (topic.clone(), why);
        if !self.kept.told.contains(&complaint) {
            tracing::warn!(%topic, "not carried: {}", complaint.1);
        }
        self.told.insert(complaint);
    }

    /// What was not used this time is not kept.
    pub fn finish(self) -> Vec<Arc<RoutePlan>> {
        let Self { kept, routes, used, told, .. } = self;
        kept.rights.retain(|key, _| used.contains(key));
        kept.told = told;
        routes
    }
}

fn named(plan: &RoutePlan) -> (Name, Side) {
    (plan.material.card.name(), plan.material.permission.side())
}
