//! Collects the plans of routes. Each key and each name occurs once, and their number is bounded.
//! It also distributes renewed certificates to running routes.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Instant;

use gdp_ros::services::is_idempotent;
use gdp_wire::Name;
use tokio::sync::watch;

use super::omissions::{Omissions, Omitted, Reason};
use crate::carries::Carries;
use crate::config::{CallConfig, MAX_CALLS, MAX_ROUTES, RuleOptions, Side, Thing, What};
use crate::graph::Graph;
use crate::manager::Plan;
use crate::permission::Permission;
use crate::renewal::{Notified, Renewal};
use crate::ros2::TopicName;
use crate::route_material::RouteMaterial;
use crate::routes::{CallPlan, Planned, RoutePlan};
use crate::{call, route};

/// State that lasts from one planning to the next.
#[derive(Default)]
pub struct PlannerState {
    /// Certificates that were issued or learnt here. Routes receive their renewals.
    rights: BTreeMap<(Name, Side), watch::Sender<Permission>>,
    /// Entities that are not carried, and what was logged about them.
    pub omissions: Omissions,
}

/// One planning.
pub struct Gathering<'a> {
    planner_state: &'a mut PlannerState,
    topics: RouteSet<route::Route>,
    calls: RouteSet<call::Route>,
    names: Names,
    used: BTreeSet<(Name, Side)>,
    omitted: Omitted,
}

/// The title of the route of each name: a node uses a name once in each direction.
type Names = BTreeMap<(Name, Side), String>;

/// All plans of one kind, with at most `most` of them.
struct RouteSet<R: Carries> {
    plans: Vec<Arc<Planned<R>>>,
    keys: BTreeSet<<Arc<Planned<R>> as Plan>::Key>,
    most: usize,
}

impl<'a> Gathering<'a> {
    /// Begins a planning with these routes, which take precedence.
    pub fn new(planner_state: &'a mut PlannerState, topics: &[Arc<RoutePlan>], calls: &[Arc<CallPlan>]) -> Self {
        let mut names = Names::new();
        let (topics, calls) =
            (RouteSet::new(topics, &mut names, MAX_ROUTES), RouteSet::new(calls, &mut names, MAX_CALLS));
        Self { planner_state, topics, calls, names, used: BTreeSet::new(), omitted: Omitted::new() }
    }

    /// Publishes the certificate of a name to its routes, and returns it with the source of its
    /// renewals.
    pub fn right(&mut self, name: Name, permission: Permission) -> (Permission, Renewal) {
        let side = permission.side();
        self.used.insert((name, side));
        let sender =
            self.planner_state.rights.entry((name, side)).or_insert_with(|| watch::Sender::new(permission.clone()));
        sender.send_if_modified(|known| {
            let is_new = *known != permission;
            if is_new {
                *known = permission.clone();
            }
            is_new
        });
        (permission, Renewal::Notified(Notified::new(sender.subscribe())))
    }

    /// Plans a route for an entity of a graph. A topic that `is_merged` may have the local name of
    /// others. Returns false if another plan has its key, or if it is omitted.
    pub fn add(
        &mut self,
        thing: Thing,
        name: &TopicName,
        rule_options: &RuleOptions,
        is_merged: bool,
        key: &(String, Arc<Graph>),
        material: RouteMaterial,
    ) -> bool {
        let ((label, graph), kind, side) = (key.clone(), material.kind.clone(), material.permission.side());
        let added = match thing {
            Thing::Topic => {
                let mut config = rule_options.topic(name, &label, kind, side.into());
                config.merged = is_merged.then(|| material.card.name());
                self.topics.add(Planned { config, label, graph, material }, &mut self.names)
            }
            Thing::Call(what) => {
                let may_replicate = what == What::Service && is_idempotent(&material.card);
                let replicate = rule_options.replicate.filter(|_| may_replicate);
                let config = CallConfig { replicate, ..CallConfig::without_files(what, name, &label, kind, side) };
                self.calls.add(Planned { config, label, graph, material }, &mut self.names)
            }
        };
        added.unwrap_or_else(|reason| {
            self.omit(thing, name, reason);
            false
        })
    }

    /// Records that an entity matches a pattern and is not carried.
    pub fn omit(&mut self, thing: Thing, name: &TopicName, reason: Reason) {
        self.omitted.insert(thing.title(name), reason);
    }

    /// Ends the planning. It drops unused certificates and logs the omitted entities.
    pub fn finish(self) -> (Vec<Arc<RoutePlan>>, Vec<Arc<CallPlan>>) {
        let Self { planner_state, topics, calls, used, omitted, .. } = self;
        planner_state.rights.retain(|key, _| used.contains(key));
        for line in planner_state.omissions.update(Instant::now(), omitted) {
            tracing::warn!("{line}");
        }
        (topics.plans, calls.plans)
    }
}

impl<R: Carries> RouteSet<R> {
    fn new(plans: &[Arc<Planned<R>>], names: &mut Names, most: usize) -> Self {
        names.extend(plans.iter().map(|plan| (named(plan), R::title(&plan.config))));
        Self { plans: plans.to_vec(), keys: plans.iter().map(Plan::key).collect(), most }
    }

    /// Adds a plan. Returns false if its key is in use. An error is another reason for which it is
    /// not added.
    fn add(&mut self, plan: Planned<R>, names: &mut Names) -> Result<bool, Reason> {
        let (plan, most) = (Arc::new(plan), self.most);
        if self.plans.len() >= most {
            return Err(Reason::NoFreeRoute(most));
        }
        if self.keys.contains(&plan.key()) {
            return Ok(false);
        }
        if let Some(other) = names.get(&named(&plan)) {
            return Err(Reason::NameIsTaken { name: plan.material.card.name(), by: other.clone() });
        }
        self.keys.insert(plan.key());
        names.insert(named(&plan), R::title(&plan.config));
        self.plans.push(plan);
        Ok(true)
    }
}

fn named<R: Carries>(plan: &Planned<R>) -> (Name, Side) {
    (plan.material.card.name(), plan.material.permission.side())
}
