//! Graph resource names: validation, and resolution to a global name. <https://wiki.ros.org/Names>
//!
//! Remappings are not known here: whoever uses this crate applies them before.

/// Bytes of a name in full. ROS has no limit; real names stay far below.
pub const MAX_NAME: usize = 1024;

/// Why a name is not one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    #[error("an empty name")]
    Empty,
    #[error(
        "the name {name:?}: {bad:?} at byte {at} cannot stand there; letters, digits, '_' and '/' can, after a \
         letter, '/' or '~'"
    )]
    Character { name: String, bad: char, at: usize },
    #[error("the name {name:?} has an empty part: leave out the second '/' or the one at the end")]
    EmptyPart { name: String },
    #[error("a name of {0} bytes: at most {MAX_NAME} are taken")]
    TooLong(usize),
    #[error("the node name {0:?} is not a full one: write it from '/', as in \"/gdp_proxy\"")]
    NotFull(String),
}

/// The full name, from `/`. `name` is global (`/a`), relative to the node's namespace (`a`), or
/// private to the node (`~a`); `node` is the node's full name.
pub fn resolve(name: &str, node: &str) -> Result<String, NameError> {
    validate(name)?;
    let namespace = &node[..=node.rfind('/').unwrap_or(0)];
    let full = match name.strip_prefix('~') {
        Some(private) => format!("{node}/{private}"),
        None if name.starts_with('/') => name.to_owned(),
        None => format!("{namespace}{name}"),
    };
    if full.len() > MAX_NAME { Err(NameError::TooLong(full.len())) } else { Ok(full) }
}

/// A node's own name: valid and in full.
pub fn validate_node(name: &str) -> Result<(), NameError> {
    validate(name)?;
    if name.starts_with('/') { Ok(()) } else { Err(NameError::NotFull(name.to_owned())) }
}

fn validate(name: &str) -> Result<(), NameError> {
    if name.is_empty() {
        return Err(NameError::Empty);
    }
    if name.len() > MAX_NAME {
        return Err(NameError::TooLong(name.len()));
    }
    let fits = |at: usize, c: char| match at {
        0 => c.is_ascii_alphabetic() || matches!(c, '/' | '~'),
        _ => c.is_ascii_alphanumeric() || matches!(c, '_' | '/'),
    };
    if let Some((at, bad)) = name.char_indices().find(|&(at, c)| !fits(at, c)) {
        return Err(NameError::Character { name: name.to_owned(), bad, at });
    }
    let parts = name.strip_prefix(['/', '~']).unwrap_or(name);
    if parts.split('/').any(str::is_empty) {
        return Err(NameError::EmptyPart { name: name.to_owned() });
    }
    Ok(())
}

#[cfg(test)]
#[path = "../tests/unit/names.rs"]
mod tests;
