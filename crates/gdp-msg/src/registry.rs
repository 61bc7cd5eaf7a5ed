//! The registry of known definitions, by dialect and name.

use std::collections::HashMap;
use std::sync::Arc;

use crate::definition::{self, Definition, DefinitionError};
use crate::dialect::Dialect;
use crate::name::TypeName;

/// Maximum number of definitions in one registry, several times that of a whole distribution.
pub const MAX_DEFINITIONS: usize = 1 << 15;

/// Definitions by dialect and name. A new definition replaces one of the same name, so a user's
/// definition overrides an embedded one. Cloning is cheap.
#[derive(Clone, Default, Debug)]
pub struct Registry {
    definitions: HashMap<(Dialect, TypeName), Arc<Definition>>,
}

/// The reason why a registry refuses definitions.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
pub enum AddError {
    #[error(transparent)]
    Definition(#[from] DefinitionError),
    #[error("more than {MAX_DEFINITIONS} definitions: load only the packages whose types are used")]
    Full,
}

impl Registry {
    /// Adds the definitions of a `.msg`, `.srv` or `.action` file. `name` consists of the package,
    /// the kind, and the file's name without its extension.
    ///
    /// # Errors
    /// If the text is invalid or the registry is full; then nothing is added.
    pub fn add_file(&mut self, dialect: Dialect, name: &TypeName, text: &str) -> Result<(), AddError> {
        self.insert(dialect, definition::definitions(dialect, name, text)?)
    }

    /// Adds the definitions of a ROS 1 connection header or a bag: that of `name` and those of all
    /// nested types.
    ///
    /// # Errors
    /// If the text is invalid or the registry is full; then nothing is added.
    pub fn add_text(&mut self, dialect: Dialect, name: &TypeName, text: &str) -> Result<(), AddError> {
        self.insert(dialect, definition::split(dialect, name, text)?)
    }

    pub fn get(&self, dialect: Dialect, name: &TypeName) -> Option<&Arc<Definition>> {
        self.definitions.get(&(dialect, name.clone()))
    }

    /// Returns the names of all definitions of a dialect, in no particular order.
    pub fn names(&self, dialect: Dialect) -> impl Iterator<Item = &TypeName> {
        self.definitions.keys().filter(move |(of, _)| *of == dialect).map(|(_, name)| name)
    }

    pub(crate) fn insert(&mut self, dialect: Dialect, definitions: Vec<Definition>) -> Result<(), AddError> {
        if self.definitions.len() + definitions.len() > MAX_DEFINITIONS {
            return Err(AddError::Full);
        }
        for definition in definitions {
            self.definitions.insert((dialect, definition.name.clone()), Arc::new(definition));
        }
        Ok(())
    }
}
