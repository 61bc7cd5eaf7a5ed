//! Validates graph resource names and resolves them to global names. <https://wiki.ros.org/Names>
//!
//! The application applies remappings before it calls this crate.

/// Maximum length of a global name, in bytes. ROS has no limit; real names are far shorter.
pub const MAX_NAME: usize = 1024;

/// The reason why a name is invalid.
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

/// Returns the global name of `name`. A name is global (`/a`), relative to the node's namespace
/// (`a`), or private to the node (`~a`). `node` is the node's global name.
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

/// Checks that a node's name is valid and global.
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
