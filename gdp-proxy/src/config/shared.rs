//! What the directory of the domain adds to the sections `expose` and `import`.

use gdp_core::cert::enrollment::split_kind;
use gdp_wire::Name;

use super::{Pattern, Thing, What};
use crate::ros2::TopicName;

/// What the directory of the domain lets members read and call.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SharedTopics {
    /// What members import under their own names.
    pub exports: PatternsByKind,
    pub readers: Vec<MemberReader>,
}

/// A member of the domain with what it may read and call, with its names in the catalog.
#[derive(Clone, Debug, PartialEq)]
pub struct MemberReader {
    pub entity: Name,
    pub names: PatternsByKind,
}

/// Patterns of topics, services and actions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PatternsByKind {
    pub topics: Vec<Pattern>,
    pub services: Vec<Pattern>,
    pub actions: Vec<Pattern>,
}

impl PatternsByKind {
    /// Adds patterns of the directory. Skips what is none.
    pub fn extend(&mut self, texts: impl IntoIterator<Item = impl AsRef<str>>) {
        for text in texts {
            let (kind, text) = split_kind(text.as_ref());
            let Ok(pattern) = Pattern::parse(text) else { continue };
            let patterns = match kind {
                "service:" => &mut self.services,
                "action:" => &mut self.actions,
                _ => &mut self.topics,
            };
            if !patterns.contains(&pattern) {
                patterns.push(pattern);
            }
        }
    }

    pub fn of(texts: impl IntoIterator<Item = impl AsRef<str>>) -> Self {
        let mut patterns = Self::default();
        patterns.extend(texts);
        patterns
    }

    pub fn of_kind(&self, thing: Thing) -> &[Pattern] {
        match thing {
            Thing::Topic => &self.topics,
            Thing::Call(What::Service) => &self.services,
            Thing::Call(What::Action) => &self.actions,
        }
    }

    pub fn covers(&self, thing: Thing, name: &TopicName) -> bool {
        self.of_kind(thing).iter().any(|pattern| pattern.covers(name))
    }

    pub fn is_empty(&self) -> bool {
        self.topics.is_empty() && self.services.is_empty() && self.actions.is_empty()
    }
}

/// An import that the directory of the domain lists.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SharedImport {
    /// What the directory lets the other member expose. Nothing else is imported, but for what
    /// keeps its name.
    pub within: PatternsByKind,
    /// What gets no prefix, with its names in the catalog. Topics of it merge.
    pub under_own_names: PatternsByKind,
}
