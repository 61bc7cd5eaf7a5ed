//! Loads the files that a configuration names: identity, name cards, certificates. The proxy reads
//! them at start, and certificates again when they change (`cert_file`). It checks them against
//! each other. So an error names the key of the configuration, and is not a refusal from a RIB
//! three hops away. The RIB verifies everything again.

pub use crate::material_error::{MaterialError, with_path};
pub use crate::permission::{Permission, check_permission, load_permission};
pub use crate::route_material::{RouteMaterial, carded_type};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use gdp_core::card::NameCard;
use gdp_core::cert::Reading;
use gdp_core::domain::{CredentialFiles, Credentials, Trust};
use gdp_core::identity::{Identity, SigningKey};
use gdp_util::file_watch::{FileSet, FileWatcher};
use gdp_wire::Name;

use crate::call;
use crate::cert_file::CertFile;
use crate::config::{Config, ExposeConfig, ImportConfig, Side, TopicConfig};
use crate::graph;
use crate::relay::Relay;
use crate::renewal::Renewal;

/// All keys and certificates of a proxy.
pub struct Material {
    pub identity: Identity,
    /// The domain credentials with their files. The watch on the files began before they were read.
    pub credentials: Option<(Credentials, FileSet)>,
    pub directory: Option<DirectoryMaterial>,
    pub relay: Option<Relay>,
    /// The routes in the order of the configuration's topics, each with the index of its topic.
    pub routes: Vec<(usize, RouteMaterial)>,
    pub expose: Option<ExposeMaterial>,
    /// The imports, in the order of the configuration.
    pub imports: Vec<ImportMaterial>,
    /// Services and actions, each with its index in [`Config::calls`].
    pub calls: Vec<(usize, RouteMaterial)>,
}

/// The key and the catalog card of `expose`.
#[derive(Clone)]
pub struct ExposeMaterial {
    pub owner: SigningKey,
    pub catalog: NameCard,
}

/// The card and the grant of an imported catalog.
#[derive(Clone)]
pub struct ImportMaterial {
    pub catalog: NameCard,
    pub grant: Reading,
    pub(crate) file: Renewal,
}

/// The card of the domain's directory, the domain, the file of this proxy's membership, and the
/// grant to read the directory.
#[derive(Clone)]
pub struct DirectoryMaterial {
    pub card: NameCard,
    pub domain: Name,
    pub membership: PathBuf,
    pub grant: Reading,
    pub(crate) file: Renewal,
}

impl Material {
    /// Reads and checks all files. `watcher` reports when a certificate is replaced later.
    pub fn load(config: &Config, watcher: &FileWatcher) -> Result<Self, MaterialError> {
        let identity = load_identity(&config.identity, "proxy")
            .map_err(|reason| MaterialError { key: "identity".into(), reason: with_path(reason, &config.identity) })?;
        let load = |(i, topic, side)| {
            load_route(topic, side, identity.name(), watcher)
                .map(|route| (i, route))
                .map_err(|(key, reason)| MaterialError { key: format!("topics[{i}].{key}"), reason })
        };
        let topics = config.topics.iter().enumerate();
        let routes = topics.flat_map(|(i, topic)| topic.direction.sides().iter().map(move |side| (i, topic, *side)));
        let routes = routes.map(load).collect::<Result<Vec<_>, _>>()?;
        let credentials =
            config.domain.as_ref().map(|domain| load_credentials(&domain.into(), identity.name(), watcher));
        let credentials = credentials.transpose()?;
        let directory = load_directory(config, identity.name(), watcher)?;
        graph::check(&config.graphs)
            .map_err(|(name, reason)| MaterialError { key: format!("graphs.{name}"), reason })?;
        let relay = Relay::load(config)?;
        let expose = config.expose.as_ref().map(load_expose).transpose()?;
        let imports = config.import.iter().enumerate();
        let imports = imports.map(|(i, import)| load_import(i, import, identity.name(), watcher));
        let imports = imports.collect::<Result<_, _>>()?;
        let calls = call::material::load(config, identity.name(), watcher)?;
        let material = Self { identity, credentials, directory, relay, routes, expose, imports, calls };
        material.check_names(config)?;
        Ok(material)
    }

    /// Checks that no two entries use the same name in the same direction. A proxy has one
    /// publisher and one subscription for each name: readers could not distinguish two topics in
    /// it.
    fn check_names(&self, config: &Config) -> Result<(), MaterialError> {
        let routes =
            self.routes.iter().map(|(at, route)| (format!("topics[{at}].card"), &route.card, route.permission.side()));
        let calls = config.calls().zip(&self.calls);
        let calls = calls.map(|((key, _), (_, call))| (format!("{key}.card"), &call.card, call.permission.side()));
        let expose = self.expose.iter().map(|expose| ("expose.catalog".into(), &expose.catalog, Side::Out));
        let imports = self.imports.iter().enumerate();
        let imports = imports.map(|(i, import)| (format!("import[{i}].catalog"), &import.catalog, Side::In));
        let mut known = BTreeMap::new();
        for (key, card, side) in routes.chain(calls).chain(expose).chain(imports) {
            let name = card.name();
            if let Some(first) = known.insert((name, side), key.clone()) {
                let reason = format!(
                    "the name {name:#} is already that of {first}, in the same direction; make a card of its own for \
                     this, or remove one of them"
                );
                return Err(MaterialError { key, reason });
            }
        }
        Ok(())
    }
}

/// Loads the key of an entity of kind `kind`.
pub(crate) fn load_identity(path: &Path, kind: &str) -> Result<Identity, String> {
    match SigningKey::load(path) {
        Ok(key) => Ok(Identity::new(key, kind)),
        Err(error) if error.is_not_found() => {
            Err(format!("{error}; make one with `gdp-ctl key generate {} --kind {kind}`", path.display()))
        }
        Err(error) => Err(error.to_string()),
    }
}

fn load_credentials(
    files: &CredentialFiles,
    entity: Name,
    watcher: &FileWatcher,
) -> Result<(Credentials, FileSet), MaterialError> {
    let wrong = |reason: String| MaterialError { key: "domain".into(), reason };
    let watched = FileSet::new(watcher, files.paths());
    let credentials = files.load().map_err(|error| wrong(error.to_string()))?;
    Trust::new(entity, credentials.clone().into(), true).map_err(|error| wrong(error.to_string()))?;
    Ok((credentials, watched))
}

/// Loads one direction of a topic. Errors come with the key inside the topic.
fn load_route(
    topic: &TopicConfig,
    side: Side,
    entity: Name,
    watcher: &FileWatcher,
) -> Result<RouteMaterial, (&'static str, String)> {
    let card = NameCard::load(&topic.card).map_err(|error| ("card", with_path(error, &topic.card)))?;
    let kind = carded_type(topic.kind.as_ref(), &card, &topic.card, "topic").map_err(|reason| ("type", reason))?;
    let key = match side {
        Side::Out => "cert",
        Side::In => "grant",
    };
    let path = topic.right(side).ok_or((key, "missing".to_owned()))?;
    let opened = CertFile::open(path, side, topic.topic.as_str(), &card, entity, watcher);
    let (file, permission) = opened.map_err(|error| (key, with_path(error, path)))?;
    Ok(RouteMaterial { card, kind, permission, file: Renewal::File(file.into()) })
}

fn load_expose(config: &ExposeConfig) -> Result<ExposeMaterial, MaterialError> {
    let wrong = |key: &str, reason| MaterialError { key: format!("expose.{key}"), reason };
    let owner = SigningKey::load(&config.owner).map_err(|error| match error.is_not_found() {
        true => {
            let path = config.owner.display();
            wrong(
                "owner",
                format!("{error}; make one for this robot's names with `gdp-ctl key generate {path} --kind owner`"),
            )
        }
        false => wrong("owner", with_path(error, &config.owner)),
    })?;
    let catalog =
        NameCard::load(&config.catalog).map_err(|error| wrong("catalog", with_path(error, &config.catalog)))?;
    if *catalog.owner_key() != owner.verify_key() {
        let (card, key) = (config.catalog.display(), config.owner.display());
        return Err(wrong("catalog", format!("{card} is a name of another owner than {key}; make it with that key")));
    }
    Ok(ExposeMaterial { owner, catalog })
}

fn load_directory(
    config: &Config,
    entity: Name,
    watcher: &FileWatcher,
) -> Result<Option<DirectoryMaterial>, MaterialError> {
    let (Some(directory), Some(domain)) = (&config.directory, &config.domain) else { return Ok(None) };
    let load = |key: &str, path: &PathBuf| {
        let wrong = |error| MaterialError { key: key.into(), reason: with_path(error, path) };
        NameCard::load(path).map_err(wrong)
    };
    let (card, of) = (load("directory.card", &directory.card)?, load("domain.card", &domain.card)?.name());
    let wrong = |reason| MaterialError { key: "directory.grant".into(), reason };
    let opened = CertFile::open(&directory.grant, Side::In, "the directory", &card, entity, watcher);
    match opened.map_err(|error| wrong(with_path(error, &directory.grant)))? {
        (file, Permission::Read(grant)) => {
            let (membership, file) = (domain.membership.clone(), Renewal::File(file.into()));
            Ok(Some(DirectoryMaterial { card, domain: of, membership, grant, file }))
        }
        (_, Permission::Publish(_)) => Err(wrong("is a permission to publish".into())),
    }
}

fn load_import(
    at: usize,
    config: &ImportConfig,
    entity: Name,
    watcher: &FileWatcher,
) -> Result<ImportMaterial, MaterialError> {
    let wrong = |key: &str, reason| MaterialError { key: format!("import[{at}].{key}"), reason };
    let catalog =
        NameCard::load(&config.catalog).map_err(|error| wrong("catalog", with_path(error, &config.catalog)))?;
    let label = config.catalog.display().to_string();
    let opened = CertFile::open(&config.grant, Side::In, &label, &catalog, entity, watcher);
    let (file, permission) = opened.map_err(|error| wrong("grant", with_path(error, &config.grant)))?;
    match permission {
        Permission::Read(grant) => Ok(ImportMaterial { catalog, grant, file: Renewal::File(file.into()) }),
        Permission::Publish(_) => Err(wrong("grant", "is a permission to publish".into())),
    }
}

#[cfg(test)]
#[path = "../tests/unit/material.rs"]
pub(crate) mod tests;
