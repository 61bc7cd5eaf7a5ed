//! A resolved message type: the definition with all nested types. It has exactly the information
//! that readers and writers need.

use std::collections::HashMap;
use std::sync::Arc;

use crate::definition::{self, Base, Definition, DefinitionError};
use crate::dialect::Dialect;
use crate::name::{NameError, TypeName, excerpt};
use crate::registry::{AddError, Registry};

/// Maximum number of types in one schema.
pub const MAX_TYPES: usize = 1024;
/// Maximum depth of nested types.
pub const MAX_DEPTH: usize = 32;

/// A message type with all types that it consists of. No type contains itself.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Schema {
    dialect: Dialect,
    /// The message's own definition, then the others in the order of their first use.
    definitions: Vec<Arc<Definition>>,
}

/// The reason why a schema cannot be resolved.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
pub enum SchemaError {
    #[error("there is no {dialect} definition of {name}: give its .msg file, or the share folder of its package")]
    Unknown { dialect: Dialect, name: TypeName },
    #[error("{field} of {name} is of type {missing}, which nobody has defined: give the share folder of its package")]
    Missing { name: TypeName, field: Box<str>, missing: TypeName },
    #[error(
        "{0} contains itself, so no message of it can be finite: make one of the fields that lead back to it \
         something else"
    )]
    Cycle(TypeName),
    #[error("types nest deeper than {MAX_DEPTH} in {0}: flatten them")]
    TooDeep(TypeName),
    #[error("{0} consists of more than {MAX_TYPES} types: split it")]
    TooMany(TypeName),
    #[error(transparent)]
    Definition(#[from] DefinitionError),
    #[error("`{0}` begins no bundle of definitions: a line `gdp-msg 1 ros1|ros2 package/msg/Type` does")]
    Bundle(String),
    #[error(transparent)]
    Name(#[from] NameError),
    #[error(transparent)]
    Add(#[from] AddError),
}

/// The start of a bundle. The number is the version of its form.
const BUNDLE: &str = "gdp-msg 1";

impl Schema {
    /// Collects the definition of `name` with those of all nested types.
    ///
    /// # Errors
    /// If a type is missing, contains itself, or is too large.
    pub fn resolve(registry: &Registry, dialect: Dialect, name: &TypeName) -> Result<Arc<Self>, SchemaError> {
        let Some(root) = registry.get(dialect, name) else {
            return Err(SchemaError::Unknown { dialect, name: name.clone() });
        };
        let mut resolving = Resolving {
            registry,
            dialect,
            root: name,
            found: HashMap::new(),
            definitions: Vec::new(),
            stack: Vec::new(),
        };
        resolving.visit(root)?;
        Ok(Arc::new(Self { dialect, definitions: resolving.definitions }))
    }

    /// Resolves a schema from a text with all definitions, as in a ROS 1 connection header or a
    /// bag.
    ///
    /// # Errors
    /// As [`Schema::resolve`], and if the text is invalid.
    pub fn from_text(dialect: Dialect, name: &TypeName, text: &str) -> Result<Arc<Self>, SchemaError> {
        let mut registry = Registry::default();
        registry.add_text(dialect, name, text)?;
        Self::resolve(&registry, dialect, name)
    }

    /// Returns the definitions of all types as the dialect's tools write them, without comments.
    pub fn text(&self) -> String {
        definition::print_all(self.definitions.iter().map(|definition| &**definition))
    }

    /// Returns the schema as text for a peer without definitions. [`Schema::from_bundle`] reads it.
    pub fn bundle(&self) -> String {
        let dialect = match self.dialect {
            Dialect::Ros1 => "ros1",
            Dialect::Ros2 => "ros2",
        };
        format!("{BUNDLE} {dialect} {}\n{}", self.name(), self.text())
    }

    /// Reads the text of [`Schema::bundle`].
    ///
    /// # Errors
    /// As [`Schema::from_text`], and if the text is not a bundle.
    pub fn from_bundle(bundle: &str) -> Result<Arc<Self>, SchemaError> {
        let (first, text) = bundle.split_once('\n').unwrap_or((bundle, ""));
        let refused = || SchemaError::Bundle(excerpt(first));
        let rest = first.strip_prefix(BUNDLE).and_then(|rest| rest.strip_prefix(' ')).ok_or_else(refused)?;
        let (dialect, name) = match rest.split_once(' ').ok_or_else(refused)? {
            ("ros1", name) => (Dialect::Ros1, name),
            ("ros2", name) => (Dialect::Ros2, name),
            _ => return Err(refused()),
        };
        Self::from_text(dialect, &TypeName::parse(name)?, text)
    }

    pub fn dialect(&self) -> Dialect {
        self.dialect
    }

    /// Returns the name of the message.
    pub fn name(&self) -> &TypeName {
        &self.root().name
    }

    /// Returns the message's own definition.
    pub fn root(&self) -> &Definition {
        &self.definitions[0]
    }

    /// Returns the definitions of all types, the message's own first.
    pub fn definitions(&self) -> impl ExactSizeIterator<Item = &Definition> {
        self.definitions.iter().map(|definition| &**definition)
    }

    /// Returns the definition of a type that a field of this schema names.
    pub(crate) fn get(&self, name: &TypeName) -> &Definition {
        let found = self.definitions.iter().find(|definition| definition.name == *name);
        found.expect("a schema contains every type that its fields name: it was resolved")
    }
}

struct Resolving<'a> {
    registry: &'a Registry,
    dialect: Dialect,
    root: &'a TypeName,
    /// The depth of each finished type, counting itself.
    found: HashMap<TypeName, usize>,
    definitions: Vec<Arc<Definition>>,
    stack: Vec<TypeName>,
}

impl Resolving<'_> {
    /// Adds a type with all nested types, and returns its depth.
    fn visit(&mut self, definition: &Arc<Definition>) -> Result<usize, SchemaError> {
        if self.stack.contains(&definition.name) {
            return Err(SchemaError::Cycle(definition.name.clone()));
        }
        if let Some(depth) = self.found.get(&definition.name) {
            return Ok(*depth);
        }
        if self.stack.len() >= MAX_DEPTH {
            return Err(SchemaError::TooDeep(self.root.clone()));
        }
        if self.definitions.len() >= MAX_TYPES {
            return Err(SchemaError::TooMany(self.root.clone()));
        }
        self.definitions.push(definition.clone());
        self.stack.push(definition.name.clone());
        let mut depth = 0;
        for field in &definition.fields {
            let Base::Named(name) = &field.base else { continue };
            let Some(inner) = self.registry.get(self.dialect, name) else {
                let (name, missing) = (definition.name.clone(), name.clone());
                return Err(SchemaError::Missing { name, field: field.name.clone(), missing });
            };
            depth = depth.max(self.visit(inner)?);
        }
        self.stack.pop();
        if self.stack.len() + depth >= MAX_DEPTH {
            return Err(SchemaError::TooDeep(self.root.clone()));
        }
        self.found.insert(definition.name.clone(), depth + 1);
        Ok(depth + 1)
    }
}
