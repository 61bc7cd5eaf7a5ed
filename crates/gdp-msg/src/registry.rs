//! The registry of known definitions, by dialect and name.

use std::collections::HashMap;
use std::sync::Arc;

use crate::definition::{self, Definition, DefinitionError};
use crate::dialect::Dialect;
use crate::name::TypeName;

/// Most definitions of one registry: several times those of a whole distribution.
pub const MAX_DEFINITIONS: usize = 1 << 15;

/// Definitions by dialect and name. A later one of the same name takes the place of an earlier one,
/// so that what a user gives wins over what is embedded. To clone one is cheap.
#[derive(Clone, Default, Debug)]
pub struct Registry {
    definitions: HashMap<(Dialect, TypeName), Arc<Definition>>,
}

/// Why a registry takes no more.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
pub enum AddError {
    #[error(transparent)]
    Definition(#[from] DefinitionError),
    #[error("more than {MAX_DEFINITIONS} definitions: load only the packages whose types are used")]
    Full,
}

impl Registry {
    /// What a `.msg`, `.srv` or `.action` file says. `name` has the package, the file's name
    /// without its ending, and its kind.
    ///
    /// # Errors
    /// For a text that is no such definition; then nothing is added.
    pub fn add_file(&mut self, dialect: Dialect, name: &TypeName, text: &str) -> Result<(), AddError> {
        self.insert(dialect, definition::definitions(dialect, name, text)?)
    }

    /// What a connection header or a bag says of a message: its own definition, and those of what
    /// it consists of.
    ///
    /// # Errors
    /// For a text that is no such definition; then nothing is added.
    pub fn add_text(&mut self, dialect: Dialect, name: &TypeName, text: &str) -> Result<(), AddError> {
        self.insert(dialect, definition::split(dialect, name, text)?)
    }

    pub fn get(&self, dialect: Dialect, name: &TypeName) -> Option<&Arc<Definition>> {
        self.definitions.get(&(dialect, name.clone()))
    }

    /// In no particular order.
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
