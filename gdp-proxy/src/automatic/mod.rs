//! Topics, services and actions that cross without a section of their own. Those of a graph that
//! match the patterns of `expose` go out. Those of a catalog that match the patterns of `import`
//! come in. Each crosses for as long as it exists.
//!
//! [`choice`] selects them, [`issuer`] makes their names and certificates, and [`listed`] reads
//! catalogs: none of these waits or sends. [`link`] carries a catalog. This module combines them
//! into plans for the managers of routes and of catalogs.

pub mod choice;
mod gather;
mod issuer;
mod link;
mod listed;
mod omissions;

use std::collections::{BTreeMap, BTreeSet};
use std::pin::Pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_util::unix_time::unix_nanos;

use anyhow::{Context, Result, anyhow};
use futures::future::select_all;
use gdp_core::card::NameCard;
use gdp_core::domain::CredentialFiles;
use gdp_directory::directory::Member;
use gdp_ros::catalog::{Catalog, Entry, MAX_ENTRIES, MAX_ENTRY_BYTES};
use gdp_wire::Name;
use tokio::sync::watch;

use self::choice::Choice;
use self::gather::{Gathering, PlannerState};
use self::issuer::{IssuedCredentials, Issuer};
use self::link::{CatalogPlan, End};
use self::listed::{Listed, chosen};
use self::omissions::Reason;
use crate::config::{ExposeConfig, ImportConfig, PatternsByKind, Thing, What, action_of_topic};
use crate::directory;
use crate::graph::{self, Found, Graph, GraphObserver};
use crate::material::ImportMaterial;
use crate::permission::Permission;
use crate::reload::Loaded;
use crate::ros2::TopicName;
use crate::route_material::RouteMaterial;
use crate::routes::{CallPlan, RoutePlan};

pub use self::choice::{check_exposed, choose};
pub use self::issuer::card_of;
pub use self::link::{CatalogStats, Links, manager};

/// How often the proxy checks for certificates to renew.
const LOOK: Duration = Duration::from_secs(60);

/// All entities that are exposed or imported by pattern.
pub struct Automatic {
    expose: Option<Expose>,
    imports: Vec<Import>,
    planner_state: PlannerState,
    look: Instant,
}

struct Expose {
    config: ExposeConfig,
    placed_in: (String, Arc<Graph>),
    graph_observer: GraphObserver,
    choice: Choice,
    issuer: Issuer,
    catalog: NameCard,
    /// The certificates by name, including the catalog's.
    issued_credentials: BTreeMap<Name, IssuedCredentials>,
    list: watch::Sender<Arc<[u8]>>,
}

struct Import {
    config: ImportConfig,
    placed_in: (String, Arc<Graph>),
    graph_observer: GraphObserver,
    material: ImportMaterial,
    listed: watch::Receiver<Arc<[Listed]>>,
    tell: Arc<watch::Sender<Arc<[Listed]>>>,
    files: Option<CredentialFiles>,
}

/// The plans for the managers of routes, calls and catalogs.
pub struct Plans {
    pub routes: Vec<Arc<RoutePlan>>,
    pub calls: Vec<Arc<CallPlan>>,
    pub catalogs: Vec<CatalogPlan>,
}

impl Automatic {
    /// Applies a configuration, and what the `members` of the domain share. It keeps the state of
    /// `before` that is still wanted.
    pub fn new(
        loaded: &Loaded,
        graphs: &graph::All,
        entity: Name,
        members: &[Member],
        before: Option<Self>,
    ) -> Result<Self> {
        let Loaded { config, material } = loaded;
        let graph = config.directory.as_ref().and_then(|directory| directory.graph.as_deref());
        let mut shared = directory::shared(members, entity, graph);
        if !config.directory.as_ref().is_some_and(|directory| directory.export) {
            shared.exposed.exports = PatternsByKind::default();
        }
        let (before_expose, mut before_imports, planner_state) = match before {
            Some(Self { expose, imports, planner_state, .. }) => (expose, imports, planner_state),
            None => (None, vec![], PlannerState::default()),
        };
        let placed_in = |label: &Option<String>| {
            let (label, _) = config.graphs.get(label.as_deref()).map_err(|reason| anyhow!(reason))?;
            let graph = graphs.get(label).cloned().context("a graph that was not joined")?;
            anyhow::Ok((label.to_owned(), graph))
        };
        let expose = match (&config.expose, &material.expose) {
            (Some(expose), Some(material)) => {
                let config = ExposeConfig { shared: shared.exposed, ..expose.clone() };
                let (placed_in, catalog) = (placed_in(&expose.graph)?, material.catalog.clone());
                let same =
                    |before: &Expose| before.catalog == catalog && Arc::ptr_eq(&before.placed_in.1, &placed_in.1);
                Some(match before_expose.filter(same) {
                    Some(before) => before.with(config),
                    None => Expose {
                        config,
                        graph_observer: GraphObserver::of(&placed_in.1),
                        placed_in,
                        choice: Choice::default(),
                        issuer: Issuer::new(material.owner.clone(), entity),
                        catalog,
                        issued_credentials: BTreeMap::new(),
                        list: watch::Sender::new(Arc::default()),
                    },
                })
            }
            _ => None,
        };
        let files = config.domain.as_ref().map(CredentialFiles::from);
        let listed = || material.imports.iter().map(|import| import.catalog.name());
        let others = shared.imports.into_iter().filter(|(_, other)| !listed().any(|name| name == other.catalog.name()));
        let imports = config.import.iter().cloned().zip(material.imports.iter().cloned()).chain(others);
        let imports = imports.map(|(config, material)| {
            let known = before_imports.iter().position(|before| before.material.catalog == material.catalog);
            let tell = match known {
                Some(at) => before_imports.swap_remove(at).tell,
                None => Arc::new(watch::Sender::new(Arc::default())),
            };
            let placed_in = placed_in(&config.graph)?;
            Ok(Import {
                config,
                graph_observer: GraphObserver::of(&placed_in.1),
                placed_in,
                material,
                listed: tell.subscribe(),
                tell,
                files: files.clone(),
            })
        });
        Ok(Self { expose, imports: imports.collect::<Result<_>>()?, planner_state, look: Instant::now() + LOOK })
    }

    /// Waits until [`Self::plan`] may return something else. Safe to cancel.
    pub async fn changed(&mut self) {
        if self.expose.is_none() && self.imports.is_empty() {
            return std::future::pending().await;
        }
        let due =
            self.expose.as_ref().and_then(|expose| expose.choice.due()).map_or(self.look, |due| due.min(self.look));
        let mut news: Vec<Pin<Box<dyn Future<Output = ()> + '_>>> =
            vec![Box::pin(tokio::time::sleep_until(due.into()))];
        if let Some(expose) = &mut self.expose {
            news.push(Box::pin(expose.graph_observer.changed()));
        }
        for Import { config, listed, graph_observer, .. } in &mut self.imports {
            news.push(Box::pin(async { _ = listed.changed().await }));
            if config.wants_calls() {
                news.push(Box::pin(graph_observer.changed()));
            }
        }
        select_all(news).await;
        self.look = Instant::now() + LOOK;
    }

    /// Returns the plans to run. Entities that the configuration lists come first, and are not
    /// exposed or imported a second time.
    pub fn plan(&mut self, topics: &[Arc<RoutePlan>], calls: &[Arc<CallPlan>]) -> Plans {
        let Self { expose, imports, planner_state, .. } = self;
        let mut gathering = Gathering::new(planner_state, topics, calls);
        let exposed = expose.as_mut().and_then(|expose| {
            let actions = carried_actions(&expose.placed_in.1, calls, imports);
            expose.plan(&mut gathering, &actions)
        });
        let mut catalogs: Vec<CatalogPlan> = exposed.into_iter().collect();
        catalogs.extend(imports.iter_mut().map(|import| import.plan(&mut gathering)));
        let (routes, calls) = gathering.finish();
        Plans { routes, calls, catalogs }
    }
}

impl Expose {
    /// Applies another configuration to the same graph and catalog.
    fn with(mut self, config: ExposeConfig) -> Self {
        let granted = |config: &ExposeConfig| (config.readers.clone(), config.scope.clone(), config.shared.clone());
        if granted(&config) != granted(&self.config) {
            self.issued_credentials.clear();
        }
        Self { config, ..self }
    }

    /// `actions` are carried as such. In ROS 1 they also have topics, which must not cross as well:
    /// a goal that arrives twice is executed twice.
    fn plan(&mut self, gathering: &mut Gathering, actions: &BTreeSet<TopicName>) -> Option<CatalogPlan> {
        self.choice.update(&self.config, &self.graph_observer.found(), Instant::now());
        let now = unix_nanos();
        let catalog = self.catalog.clone();
        let own = issued_credentials(&self.issuer, &mut self.issued_credentials, &self.config, (&catalog, None), now)?;
        let (_, renewal) = gathering.right(catalog.name(), Permission::Publish(own.cert.clone()));
        let (mut entries, mut bytes, mut names) = (BTreeMap::new(), 0, BTreeSet::from([catalog.name()]));
        let mut is_full = None;
        for (thing, called, kind, exposed) in self.choice.iter() {
            let action = if thing == Thing::Topic { action_of_topic(called, kind) } else { None };
            if action.is_some_and(|action| actions.contains(&action)) {
                continue;
            }
            if entries.len() >= MAX_ENTRIES {
                is_full = is_full.or(Some(Reason::CatalogHasAllNames));
            }
            if let Some(reason) = &is_full {
                gathering.omit(thing, called, reason.clone());
                continue;
            }
            let card = match self.issuer.card(thing, kind, exposed) {
                Ok(card) => card,
                Err(error) => {
                    gathering.omit(thing, called, Reason::Failed(error.to_string()));
                    continue;
                }
            };
            let name = card.name();
            if entries.contains_key(&name) {
                gathering.omit(thing, called, Reason::RemappedOntoAnother);
                continue;
            }
            let named = (&card, Some((thing, &exposed.name)));
            let Some(issued) = issued_credentials(&self.issuer, &mut self.issued_credentials, &self.config, named, now)
            else {
                continue;
            };
            names.insert(name);
            let entry = Entry { metadata: card.metadata().clone(), grants: issued.grants };
            let size = match entry.size() {
                Ok(size) => size,
                Err(error) => {
                    gathering.omit(thing, called, Reason::Failed(error.to_string()));
                    continue;
                }
            };
            if bytes + size > MAX_ENTRY_BYTES {
                gathering.omit(thing, called, is_full.insert(Reason::CatalogHasAllBytes).clone());
                continue;
            }
            let (permission, file) = gathering.right(name, Permission::Publish(issued.cert));
            let material = RouteMaterial { card, kind: kind.cloned(), permission, file };
            if gathering.add(thing, called, &exposed.rule_options, false, &self.placed_in, material) {
                entries.insert(name, entry);
                bytes += size;
            }
        }
        // Certificates of names that are not carried stay too, because issuing them is work.
        self.issued_credentials.retain(|name, _| names.contains(name));
        let list = Catalog::new(entries.into_values().collect()).map_err(|error| error.to_string());
        match list.and_then(|list| list.to_bytes().map_err(|error| error.to_string())) {
            Ok(list) => {
                self.list.send_if_modified(|known| {
                    let is_new = **known != *list;
                    if is_new {
                        *known = list.into();
                    }
                    is_new
                });
            }
            Err(error) => tracing::error!("the catalog stays as it was: {error}"),
        }
        Some(CatalogPlan { card: catalog, renewal, end: End::Writes(own.cert, self.list.subscribe()) })
    }
}

/// Returns the names of the actions that the proxy carries in a graph, apart from exposed ones.
fn carried_actions(graph: &Arc<Graph>, calls: &[Arc<CallPlan>], imports: &[Import]) -> BTreeSet<TopicName> {
    let listed = calls.iter().filter(|plan| plan.config.what == What::Action && Arc::ptr_eq(&plan.graph, graph));
    let mut actions: BTreeSet<TopicName> = listed.map(|plan| plan.config.name.clone()).collect();
    for import in imports.iter().filter(|import| Arc::ptr_eq(&import.placed_in.1, graph)) {
        let listed = import.listed.borrow();
        let chosen = chosen(&import.config, &listed).into_keys();
        actions.extend(chosen.filter_map(|(thing, name)| (thing == Thing::Call(What::Action)).then_some(name)));
    }
    actions
}

/// Returns the known certificates, or issues new ones if they are old. `called` is what it is in
/// the catalog, `None` for the catalog itself.
fn issued_credentials(
    issuer: &Issuer,
    known: &mut BTreeMap<Name, IssuedCredentials>,
    config: &ExposeConfig,
    (card, called): (&NameCard, Option<(Thing, &TopicName)>),
    now: u64,
) -> Option<IssuedCredentials> {
    let name = card.name();
    if let Some(issued_credentials) = known.get(&name).filter(|issued_credentials| !issued_credentials.are_old(now)) {
        return Some(issued_credentials.clone());
    }
    match issuer.issue(name, called, config, now) {
        Ok(issued_credentials) => {
            known.insert(name, issued_credentials.clone());
            Some(issued_credentials)
        }
        Err(error) => {
            tracing::error!(%name, "no certificate: {error}");
            None
        }
    }
}

impl Import {
    fn plan(&mut self, gathering: &mut Gathering) -> CatalogPlan {
        let listed = self.listed.borrow_and_update().clone();
        let rule_options = self.config.rule_options();
        let here = if self.config.wants_calls() { self.graph_observer.found() } else { Found::new() };
        for ((thing, called), Listed { card, name, kind, right, .. }) in chosen(&self.config, &listed) {
            // Two servers would both execute each call.
            if thing != Thing::Topic && here.contains_key(&(thing, called.clone())) {
                gathering.omit(thing, &called, Reason::ServedHere);
                continue;
            }
            let (permission, file) = gathering.right(card.name(), Permission::Read(right.clone()));
            let material = RouteMaterial { card: card.clone(), kind: kind.clone(), permission, file };
            let is_merged = self.config.merges(thing, name);
            gathering.add(thing, &called, &rule_options, is_merged, &self.placed_in, material);
        }
        let ImportMaterial { catalog, grant, file } = self.material.clone();
        let end = End::Reads(grant, self.tell.clone(), self.files.clone());
        CatalogPlan { card: catalog, renewal: file, end }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/automatic.rs"]
mod tests;
