//! The program of a mapping: a flat list of steps.

use std::fmt::Write;

use crate::definition::{Count, Scalar};

/// One step. Bodies are the steps behind, so many of them.
#[derive(Clone, Copy, Debug)]
pub(super) enum Op {
    /// So many in a row; between binary encodings, also those of several fields that are equally
    /// large.
    Scalars {
        from: Scalar,
        to: Scalar,
        count: u32,
    },
    /// An array or a sequence with `per` scalars for each element.
    Array {
        from: Scalar,
        to: Scalar,
        count: Count,
        per: u32,
    },
    /// An integer of 32 bits whose sign the other side has not, or has.
    Narrow {
        from: Scalar,
        to: Scalar,
    },
    Text {
        from: Text,
        to: Text,
    },
    /// A text that names a frame, with the program's prefix in front.
    Frame {
        from: Text,
        to: Text,
    },
    /// Does the body for each element; each takes at least so many bytes.
    Repeat {
        count: Count,
        body: u32,
        least: u64,
    },
    /// The message of the body, with these members.
    Open {
        from: u32,
    },
    /// Goes to this member.
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
    /// A message without fields.
    Empty,
    /// Reads with the body, and writes nothing.
    Drop {
        body: u32,
    },
    /// Writes with the body, and reads nothing.
    Fill {
        body: u32,
    },
    /// Writes a header's `seq`.
    Seq {
        is_first: bool,
    },
}

/// How one side has a text.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Text {
    pub wide: bool,
    /// In bytes, or of wide text in UTF-16 code units.
    pub most: Option<u32>,
}

#[derive(Default, Debug)]
pub(super) struct Program {
    pub ops: Vec<Op>,
    /// Of each step, the field that it is for: an index of `fields`.
    pub of: Vec<u32>,
    /// The first is the message itself.
    pub fields: Vec<FieldPath>,
    /// Members of objects, as steps refer to them.
    pub members: Vec<Vec<Box<str>>>,
    /// Of [`Op::Frame`].
    pub frame_prefix: Box<str>,
}

/// Where a field is.
#[derive(Debug)]
pub(super) struct FieldPath {
    /// The field that it is inside of.
    pub parent: u32,
    pub name: Box<str>,
    pub repeated: bool,
}

impl Program {
    /// Of the field that a step is for. `indices`: of the elements on the way to it, the innermost
    /// first.
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
