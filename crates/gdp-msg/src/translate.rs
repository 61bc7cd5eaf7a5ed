//! Translates a type of one dialect to the other, for types that the other dialect does not define.

use std::sync::Arc;

use crate::definition::{Base, Constant, Count, Definition, Field, Scalar};
use crate::dialect::Dialect;
use crate::name::{InterfaceKind, TypeName};
use crate::registry::Registry;
use crate::schema::{Schema, SchemaError};

impl Schema {
    /// Returns the same type in another dialect. Definitions come from `known`, or else are made
    /// from this schema. `time`, `duration`, `byte` and bounds become the other dialect's
    /// equivalents; names stay. A made definition has the hash that ROS would compute for it. So
    /// subscribers accept it if their own definition is the same.
    ///
    /// # Errors
    /// As [`Schema::resolve`].
    pub fn in_dialect(&self, dialect: Dialect, known: &Registry) -> Result<Arc<Self>, SchemaError> {
        let mut registry = known.clone();
        let unknown = self.definitions().filter(|definition| known.get(dialect, &definition.name).is_none());
        let made = unknown.map(|definition| match dialect {
            _ if dialect == self.dialect() => definition.clone(),
            Dialect::Ros1 => made(definition, to_ros1),
            Dialect::Ros2 => made(definition, to_ros2),
        });
        registry.insert(dialect, made.collect())?;
        Self::resolve(&registry, dialect, self.name())
    }
}

fn made(definition: &Definition, convert: impl Fn(&Base, Count) -> (Base, Count)) -> Definition {
    let fields = definition.fields.iter().map(|field| {
        let (base, count) = convert(&field.base, field.count);
        Field::new(base, count, &field.name)
    });
    // The dialects write string constants differently, so these are left out.
    let constants = definition.constants.iter().filter(|constant| matches!(constant.base, Base::Scalar(_)));
    let constants =
        constants.map(|constant| Constant { base: convert(&constant.base, Count::One).0, ..constant.clone() });
    Definition { name: definition.name.clone(), constants: constants.collect(), fields: fields.collect() }
}

fn to_ros2(base: &Base, count: Count) -> (Base, Count) {
    let base = match base {
        Base::Time => named("Time").map_or(Base::Time, Base::Named),
        Base::Duration => named("Duration").map_or(Base::Duration, Base::Named),
        Base::Scalar(Scalar::Byte) => Base::Scalar(Scalar::Int8),
        other => other.clone(),
    };
    (base, count)
}

fn to_ros1(base: &Base, count: Count) -> (Base, Count) {
    let base = match base {
        Base::Named(name) if Some(name) == named("Time").as_ref() => Base::Time,
        Base::Named(name) if Some(name) == named("Duration").as_ref() => Base::Duration,
        Base::Scalar(Scalar::Byte | Scalar::Char) => Base::Scalar(Scalar::UInt8),
        Base::String(_) => Base::String(None),
        other => other.clone(),
    };
    let count = match count {
        Count::Sequence(_) => Count::Sequence(None),
        other => other,
    };
    (base, count)
}

fn named(name: &str) -> Option<TypeName> {
    TypeName::new("builtin_interfaces", InterfaceKind::Message, name).ok()
}

#[cfg(test)]
#[path = "../tests/unit/translate.rs"]
mod tests;
