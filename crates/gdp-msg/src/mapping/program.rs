//! The program of a mapping: a flat list of steps.

use std::fmt::Write;

use crate::definition::{Count, Scalar};

/// One step of a program. The body of a step is the `body` steps that follow it.
#[derive(Clone, Copy, Debug)]
pub(super) enum Op {
    /// Copies `count` consecutive scalars. Between binary encodings these may be several fields of
    /// equal size.
    Scalars {
        from: Scalar,
        to: Scalar,
        count: u32,
    },
    /// Copies an array or a sequence with `per` scalars for each element.
    Array {
        from: Scalar,
        to: Scalar,
        count: Count,
        per: u32,
    },
    /// Copies a 32-bit integer that only one side has as signed.
    Narrow {
        from: Scalar,
        to: Scalar,
    },
    Text {
        from: Text,
        to: Text,
    },
    /// Copies the name of a frame and puts the program's prefix before it.
    Frame {
        from: Text,
        to: Text,
    },
    /// Runs the body for each element. An element takes at least `least` bytes of input.
    Repeat {
        count: Count,
        body: u32,
        least: u64,
    },
    /// Opens an object with the members `members[from]`.
    Open {
        from: u32,
    },
    /// Moves the source to this member.
    Take {
        from: u32,
        member: u32,
    },
    Put {
        to: u32,
        member: u32,
    },
    Close {
        from: u32,
    },
    /// Copies a message without fields.
    Empty,
    /// Runs the body to read, and writes nothing.
    Drop {
        body: u32,
    },
    /// Runs the body to write, and reads nothing.
    Fill {
        body: u32,
    },
    /// Writes a header's `seq`.
    Seq {
        is_first: bool,
    },
}

/// The form of a text on one side.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Text {
    pub wide: bool,
    /// Maximum length in bytes, or for wide text in UTF-16 code units.
    pub most: Option<u32>,
}

#[derive(Default, Debug)]
pub(super) struct Program {
    pub ops: Vec<Op>,
    /// The field of each step, as an index of `fields`.
    pub of: Vec<u32>,
    /// The fields. The first one is the message itself.
    pub fields: Vec<FieldPath>,
    /// The members of objects, to which steps refer by index.
    pub members: Vec<Vec<Box<str>>>,
    /// The prefix for [`Op::Frame`].
    pub frame_prefix: Box<str>,
}

/// The position of a field in the message.
#[derive(Debug)]
pub(super) struct FieldPath {
    /// The index of the field that contains it.
    pub parent: u32,
    pub name: Box<str>,
    pub repeated: bool,
}

impl Program {
    /// Returns the path of a step's field. `indices` are those of the elements on the path,
    /// innermost first.
    pub fn path(&self, op: usize, indices: &[u32]) -> String {
        self.path_of(self.of.get(op).copied().unwrap_or(0), indices)
    }

    pub fn path_of(&self, field: u32, indices: &[u32]) -> String {
        let mut chain = Vec::new();
        let mut at = field;
        while at != 0 {
            let place = &self.fields[at as usize];
            chain.push(place);
            at = place.parent;
        }
        let mut indices = indices.iter().rev();
        let mut path = String::new();
        for place in chain.into_iter().rev() {
            if !path.is_empty() {
                path.push('.');
            }
            path.push_str(&place.name);
            if place.repeated
                && let Some(index) = indices.next()
            {
                let _ = write!(path, "[{index}]");
            }
        }
        path
    }
}
