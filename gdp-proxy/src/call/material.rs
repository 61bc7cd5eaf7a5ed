//! Loads the files that the configuration names for a service or an action. [`crate::material`]
//! loads those of topics.

use std::path::Path;

use gdp_core::card::NameCard;
use gdp_ros::services::is_idempotent;
use gdp_util::file_watch::FileWatcher;
use gdp_wire::Name;

use crate::cert_file::CertFile;
use crate::config::{CallConfig, Config};
use crate::material_error::{MaterialError, with_path};
use crate::renewal::Renewal;
use crate::route_material::{RouteMaterial, carded_type};

/// Loads the files of all entries, each with its index in [`Config::calls`].
pub fn load(
    config: &Config,
    entity: Name,
    watcher: &FileWatcher,
) -> Result<Vec<(usize, RouteMaterial)>, MaterialError> {
    let load = |(at, (key, call))| {
        let wrong = |(part, reason)| MaterialError { key: format!("{key}.{part}"), reason };
        Ok((at, load_one(call, entity, watcher).map_err(wrong)?))
    };
    config.calls().enumerate().map(load).collect()
}

fn load_one(call: &CallConfig, entity: Name, watcher: &FileWatcher) -> Result<RouteMaterial, (&'static str, String)> {
    let card = NameCard::load(&call.card).map_err(|error| ("card", with_path(error, &call.card)))?;
    let what = call.what.as_str();
    if let Some(kind) = card.get("kind").filter(|kind| *kind != what) {
        return Err(("card", format!("{} is of a {kind}; make one of kind {what}", call.card.display())));
    }
    if call.replicate.is_some() && !is_idempotent(&card) {
        return Err(("replicate", not_idempotent(&call.card)));
    }
    let kind = carded_type(call.kind.as_ref(), &card, &call.card, what).map_err(|reason| ("type", reason))?;
    let (key, path) = call.right();
    let path = path.ok_or((key, "missing".to_owned()))?;
    let opened = CertFile::open(path, call.side, call.name.as_str(), &card, entity, watcher);
    let (file, permission) = opened.map_err(|error| (key, with_path(error, path)))?;
    Ok(RouteMaterial { card, kind, permission, file: Renewal::File(file.into()) })
}

fn not_idempotent(card: &Path) -> String {
    format!(
        "the owner has not marked the service of {} as idempotent, so a call must not go to several servers: remove it, \
         or ask the owner for a name made with gdp-ctl name create --idempotent",
        card.display()
    )
}

#[cfg(test)]
#[path = "../../tests/unit/call/material.rs"]
mod tests;
