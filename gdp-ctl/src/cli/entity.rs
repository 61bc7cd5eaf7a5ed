//! Entities on the command line: by their name, by a key file, or by the first digits of their name
//! where a ledger lists those that are meant.

use std::path::Path;

use anyhow::bail;
use gdp_core::identity::{Identity, KeyFile, SigningKey, VerifyKey};
use gdp_core::name::NamePrefix;
use gdp_core::secret_file::SecretFileError;
use gdp_wire::Name;

use super::key::EntityKind;

/// Kind of an entity whose key file and command line state none.
pub const DEFAULT_KIND: &str = "proxy";

/// Parses the name of an entity: 64 hex digits, or a key file that states its kind.
pub fn parse_entity(text: &str) -> Result<Name, String> {
    let path = Path::new(text);
    match text.parse() {
        Ok(name) => Ok(name),
        Err(_) if path.is_file() => of_key_file(path),
        Err(_) => Err("a name is 64 hex digits; print it with `gdp-ctl key show FILE`, or write the key's file".into()),
    }
}

/// Parses the name of an entity as [`parse_entity`] does, or its first digits.
pub fn parse_entity_prefix(text: &str) -> Result<NamePrefix, String> {
    match parse_entity(text) {
        Ok(name) => Ok(name.into()),
        Err(reason) if Path::new(text).is_file() => Err(reason),
        Err(reason) => text.parse().map_err(|_| reason),
    }
}

/// Returns the only one of the known names with this prefix, or `None` if there is none.
pub fn find(prefix: &NamePrefix, known: impl Iterator<Item = Name>) -> anyhow::Result<Option<Name>> {
    let mut found: Vec<Name> = known.filter(|name| prefix.matches(name)).collect();
    found.sort();
    found.dedup();
    match found[..] {
        [] => Ok(None),
        [name] => Ok(Some(name)),
        _ => {
            let names: Vec<String> = found.iter().map(Name::to_string).collect();
            bail!("{prefix} is the beginning of several names: {}; write more digits", names.join(", "))
        }
    }
}

/// Parses a public key: 66 hex digits, or the file of its private key.
pub fn parse_public_key(text: &str) -> Result<VerifyKey, String> {
    let path = Path::new(text);
    match text.parse() {
        Ok(key) => Ok(key),
        Err(_) if path.exists() => Ok(SigningKey::load(path).map_err(|error| error.to_string())?.verify_key()),
        Err(_) => {
            Err("neither a key file nor a public key: 66 hex digits, as `gdp-ctl -j key show FILE` has them".into())
        }
    }
}

/// Loads the entity of a key file. A kind on the command line overrides that of the file.
pub fn load(path: &Path, kind: Option<EntityKind>) -> Result<Identity, SecretFileError> {
    let file = KeyFile::load(path)?;
    Ok(match kind {
        Some(kind) => Identity::new(file.key, kind.as_str()),
        None => file.identity_or(DEFAULT_KIND),
    })
}

fn of_key_file(path: &Path) -> Result<Name, String> {
    let KeyFile { key, kind } = KeyFile::load(path).map_err(|error| error.to_string())?;
    match kind {
        Some(kind) => Ok(Identity::new(key, &kind).name()),
        None => {
            let file = path.display();
            Err(format!(
                "{file} does not state its kind, which is part of the name; print the name of a proxy with `gdp-ctl \
                 key show {file} --kind proxy`, and write that"
            ))
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/cli/entity.rs"]
mod tests;
