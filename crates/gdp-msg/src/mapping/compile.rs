//! Compiles two schemas to a program.

use super::pair::{Step, Unpaired, pair};
use super::program::{FieldPath, Op, Program, Text};
use crate::definition::{Base, Count, Definition, Field, Scalar, type_text};
use crate::dialect::Dialect;
use crate::encode::Encoding;
use crate::mapping::options::Note;
use crate::name::TypeName;
use crate::schema::Schema;

/// Maximum number of steps in a program, hundreds of times that of a distribution's largest
/// message. Nested types with several fields each multiply.
const MAX_OPS: usize = 1 << 16;

/// The reason why there is no mapping between two types.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
pub enum MapError {
    #[error("`{path}` is {from} on the sending side and {to} on the receiving side: bring both to the same definition")]
    Type { path: String, from: String, to: String },
    #[error(
        "{from} and {to} differ{}: {} against {}; fields pair by name, or by position if their types agree",
        if path.is_empty() { String::new() } else { format!(" in `{path}`") }, listed(from_only), listed(to_only)
    )]
    Fields { path: String, from: Box<str>, to: Box<str>, from_only: Vec<Box<str>>, to_only: Vec<Box<str>> },
    #[error("`{path}` comes earlier on one side than on the other: bring the fields into the same order")]
    Order { path: String },
    #[error("a message of {0} takes more than {MAX_OPS} steps to read: split it")]
    TooLarge(TypeName),
}

fn listed(fields: &[Box<str>]) -> String {
    if fields.is_empty() { "nothing".into() } else { format!("`{}`", fields.join("`, `")) }
}

pub(super) fn compile(
    from: &Schema,
    from_encoding: Encoding,
    to: &Schema,
    to_encoding: Encoding,
    frame_prefix: &str,
) -> Result<(Program, Vec<Note>), MapError> {
    let json = [from_encoding, to_encoding].contains(&Encoding::Json);
    let program = Program { frame_prefix: frame_prefix.into(), ..Program::default() };
    let mut compiler =
        Compiler { root: from.name(), json, program, notes: Vec::new(), field: 0, is_frame: false, barrier: 0 };
    compiler.program.fields.push(FieldPath { parent: 0, name: "".into(), repeated: false });
    let (from_shape, to_shape) = (Shape::of_message(from.root()), Shape::of_message(to.root()));
    compiler.shape(from, from_shape, to, to_shape)?;
    Ok((compiler.program, compiler.notes))
}

/// The form of a type in a program.
#[derive(Clone, Copy)]
enum Shape<'a> {
    /// A scalar. `signless` is true for a `byte`, which only one dialect has as signed, with the
    /// same eight bits.
    Scalar {
        kind: Scalar,
        signless: bool,
    },
    Text(Text),
    /// A time or a duration, with its two numbers.
    Stamp([(&'static str, Scalar); 2]),
    Message(&'a Definition),
}

impl<'a> Shape<'a> {
    fn of(schema: &'a Schema, base: &Base, count: Count) -> Self {
        match base {
            // Arrays of bytes are octets in both dialects and in JSON.
            Base::Scalar(Scalar::Byte) if count != Count::One => Self::Scalar { kind: Scalar::UInt8, signless: true },
            Base::Scalar(scalar) => {
                Self::Scalar { kind: scalar.plain(schema.dialect()), signless: *scalar == Scalar::Byte }
            }
            Base::String(most) => Self::Text(Text { wide: false, most: *most }),
            Base::WString(most) => Self::Text(Text { wide: true, most: *most }),
            Base::Time => Self::Stamp([("secs", Scalar::UInt32), ("nsecs", Scalar::UInt32)]),
            Base::Duration => Self::Stamp([("secs", Scalar::Int32), ("nsecs", Scalar::Int32)]),
            Base::Named(name) => Self::of_message(schema.get(name)),
        }
    }

    fn of_message(definition: &'a Definition) -> Self {
        let name = &definition.name;
        let stamp = [("sec", Scalar::Int32), ("nanosec", Scalar::UInt32)];
        let is = |(name, scalar): (&str, Scalar)| Field::new(Base::Scalar(scalar), Count::One, name);
        let named = ["Time", "Duration"].iter().any(|stamp| name.is_message("builtin_interfaces", stamp));
        if named && definition.fields == stamp.map(is) {
            return Self::Stamp(stamp);
        }
        Self::Message(definition)
    }
}

impl Shape<'_> {
    fn is_same_scalar(self, other: Self) -> bool {
        let (Self::Scalar { kind, signless }, Self::Scalar { kind: other, signless: other_signless }) = (self, other)
        else {
            return false;
        };
        kind == other
            || ((signless || other_signless)
                && kind.size() == 1
                && other.size() == 1
                && ![kind, other].contains(&Scalar::Bool))
    }
}

struct Compiler<'a> {
    /// The name of the message.
    root: &'a TypeName,
    /// Whether one of the encodings is JSON, which has names and brackets.
    json: bool,
    program: Program,
    notes: Vec<Note>,
    /// The index of the field that is being compiled.
    field: u32,
    /// Whether the field names a frame that gets a prefix.
    is_frame: bool,
    /// The first step that may merge with later scalars.
    barrier: usize,
}

/// Minimum size of a value in the source encoding, in bytes.
type Least = u64;

impl Compiler<'_> {
    fn push(&mut self, op: Op) -> Result<usize, MapError> {
        let Program { ops, of, .. } = &mut self.program;
        if ops.len() >= MAX_OPS {
            return Err(MapError::TooLarge(self.root.clone()));
        }
        ops.push(op);
        of.push(self.field);
        Ok(ops.len() - 1)
    }

    /// Begins a step with a body; [`Compiler::body`] returns the length of the body.
    fn push_bodied(&mut self, op: Op) -> Result<usize, MapError> {
        let at = self.push(op)?;
        self.barrier = at + 1;
        Ok(at)
    }

    fn body(&mut self, at: usize) -> u32 {
        self.barrier = self.program.ops.len();
        (self.program.ops.len() - at - 1) as u32
    }

    fn scalars(&mut self, from: Scalar, to: Scalar, count: u32) -> Result<Least, MapError> {
        let least = from.size() as u64 * u64::from(count);
        let is_open = self.program.ops.len() > self.barrier;
        if let Some(Op::Scalars { from: before, count: so_far, .. }) = self.program.ops.last_mut()
            && is_open
            && !self.json
            && before.size() == from.size()
            // Booleans are validated, so they do not merge with other scalars.
            && (*before == Scalar::Bool) == (from == Scalar::Bool)
            && let Some(sum) = so_far.checked_add(count)
        {
            *so_far = sum;
            return Ok(least);
        }
        self.push(Op::Scalars { from, to, count })?;
        Ok(least)
    }

    fn shape(&mut self, from: &Schema, a: Shape<'_>, to: &Schema, b: Shape<'_>) -> Result<Least, MapError> {
        match (a, b) {
            (Shape::Scalar { kind: from, .. }, Shape::Scalar { kind: to, .. }) if a.is_same_scalar(b) => {
                self.scalars(from, to, 1)
            }
            (Shape::Text(from), Shape::Text(to)) => {
                self.push(if self.is_frame { Op::Frame { from, to } } else { Op::Text { from, to } }).map(|_| 4)
            }
            (Shape::Stamp(a), Shape::Stamp(b)) => self.stamp(a, b),
            (Shape::Message(a), Shape::Message(b)) => self.message(from, a, to, b),
            _ => Err(self.differ(excerpt(a), excerpt(b))),
        }
    }

    fn differ(&self, from: String, to: String) -> MapError {
        MapError::Type { path: self.path(), from, to }
    }

    fn path(&self) -> String {
        self.program.path_of(self.field, &[])
    }

    fn stamp(&mut self, a: [(&'static str, Scalar); 2], b: [(&'static str, Scalar); 2]) -> Result<Least, MapError> {
        let members = [a, b].map(|stamp| self.members(stamp.map(|(name, _)| name.into()).into()));
        self.open(members)?;
        for (member, ((_, from), (_, to))) in a.into_iter().zip(b).enumerate() {
            self.take(members, member)?;
            self.put(members, member)?;
            if from == to {
                self.scalars(from, to, 1)?;
            } else {
                self.push(Op::Narrow { from, to })?;
            }
        }
        self.close(members)?;
        Ok(8)
    }

    fn message(&mut self, from: &Schema, a: &Definition, to: &Schema, b: &Definition) -> Result<Least, MapError> {
        let steps = pair((from.dialect(), a), (to.dialect(), b)).map_err(|unpaired| self.unpaired(a, b, unpaired))?;
        let names = |definition: &Definition| definition.fields.iter().map(|field| field.name.clone()).collect();
        let members = if self.json { [a, b].map(|definition| self.members(names(definition))) } else { [0; 2] };
        self.open(members)?;
        let mut least = 0;
        if steps.is_empty() {
            self.push(Op::Empty)?;
        }
        for step in steps {
            match step {
                Step::Both(f, t) => {
                    self.take(members, f)?;
                    self.put(members, t)?;
                    self.is_frame = !self.program.frame_prefix.is_empty() && is_frame(a, &a.fields[f]);
                    least += self.field(from, &a.fields[f], to, &b.fields[t])?;
                    self.is_frame = false;
                }
                Step::From(f) => {
                    self.take(members, f)?;
                    least += self.dropped(from, a, &a.fields[f], to.dialect())?;
                }
                Step::To(t) => {
                    self.put(members, t)?;
                    self.filled(to, b, &b.fields[t], from.dialect())?;
                }
            }
        }
        self.close(members)?;
        Ok(least)
    }

    fn unpaired(&self, a: &Definition, b: &Definition, unpaired: Unpaired) -> MapError {
        let path = self.path();
        let names = |definition: &Definition, left: Vec<usize>| {
            left.into_iter().map(|index| definition.fields[index].name.clone()).collect()
        };
        let [from, to] = [a, b].map(|definition| definition.name.to_string().into());
        match unpaired {
            Unpaired::Left(from_only, to_only) => {
                MapError::Fields { path, from, to, from_only: names(a, from_only), to_only: names(b, to_only) }
            }
            Unpaired::Order(index) => {
                let name = &a.fields[index].name;
                MapError::Order { path: if path.is_empty() { name.to_string() } else { format!("{path}.{name}") } }
            }
        }
    }

    fn field(&mut self, from: &Schema, a: &Field, to: &Schema, b: &Field) -> Result<Least, MapError> {
        let parent = std::mem::replace(&mut self.field, self.program.fields.len() as u32);
        let repeated = a.count != Count::One;
        self.program.fields.push(FieldPath { parent, name: a.name.clone(), repeated });
        let count = match (a.count, b.count) {
            (Count::Sequence(a), Count::Sequence(b)) => Count::Sequence(a.into_iter().chain(b).min()),
            (a, b) if a == b => a,
            _ => return Err(self.differ(type_text(&a.base, a.count), type_text(&b.base, b.count))),
        };
        let (a, b) = (Shape::of(from, &a.base, count), Shape::of(to, &b.base, count));
        let least = self.counted(from, a, to, b, count);
        self.field = parent;
        least
    }

    fn counted(
        &mut self,
        from: &Schema,
        a: Shape<'_>,
        to: &Schema,
        b: Shape<'_>,
        count: Count,
    ) -> Result<Least, MapError> {
        if count == Count::One {
            return self.shape(from, a, to, b);
        }
        if let (true, Shape::Scalar { kind: from, .. }, Shape::Scalar { kind: to, .. }) = (self.json, a, b)
            && a.is_same_scalar(b)
        {
            self.push(Op::Array { from, to, count, per: 1 })?;
            let (size, length) = (from.size() as u64, if let Count::Fixed(length) = count { length } else { 0 });
            return Ok(if length > 0 { size * u64::from(length) } else { 4 });
        }
        let barrier = self.barrier;
        let at = self.push_bodied(Op::Repeat { count, body: 0, least: 0 })?;
        let least = self.shape(from, a, to, b)?;
        if let (false, [Op::Scalars { from, to, count: per }]) = (self.json, &self.program.ops[at + 1..]) {
            let (from, to, per) = (*from, *to, *per);
            let all = if let Count::Fixed(length) = count { length.checked_mul(per) } else { Some(0) };
            if let Some(all) = all {
                self.program.ops.truncate(at);
                self.program.of.truncate(at);
                self.barrier = barrier;
                if let Count::Fixed(_) = count {
                    return self.scalars(from, to, all);
                }
                self.push(Op::Array { from, to, count, per })?;
                return Ok(4);
            }
        }
        let body = self.body(at);
        self.program.ops[at] = Op::Repeat { count, body, least };
        Ok(if let Count::Fixed(length) = count { least.saturating_mul(length.into()) } else { 4 })
    }

    fn dropped(&mut self, schema: &Schema, of: &Definition, field: &Field, other: Dialect) -> Result<Least, MapError> {
        if !is_seq(schema, of, field, other) {
            self.notes.push(Note::Dropped(self.path_to(field)));
        }
        let at = self.push_bodied(Op::Drop { body: 0 })?;
        let least = self.field(schema, field, schema, field)?;
        self.program.ops[at] = Op::Drop { body: self.body(at) };
        Ok(least)
    }

    fn filled(&mut self, schema: &Schema, of: &Definition, field: &Field, other: Dialect) -> Result<(), MapError> {
        if is_seq(schema, of, field, other) {
            // Whether the header is a field of the message itself.
            let is_first = self.field != 0 && self.program.fields[self.field as usize].parent == 0;
            return self.push(Op::Seq { is_first }).map(|_| ());
        }
        self.notes.push(Note::Filled(self.path_to(field)));
        let at = self.push_bodied(Op::Fill { body: 0 })?;
        self.field(schema, field, schema, field)?;
        self.program.ops[at] = Op::Fill { body: self.body(at) };
        Ok(())
    }

    fn path_to(&self, field: &Field) -> String {
        let path = self.path();
        if path.is_empty() { field.name.to_string() } else { format!("{path}.{}", field.name) }
    }

    fn members(&mut self, members: Vec<Box<str>>) -> u32 {
        if self.json {
            self.program.members.push(members);
        }
        (self.program.members.len() as u32).saturating_sub(1)
    }

    fn open(&mut self, [from, _]: [u32; 2]) -> Result<(), MapError> {
        if self.json { self.push(Op::Open { from }).map(|_| ()) } else { Ok(()) }
    }

    fn take(&mut self, [from, _]: [u32; 2], member: usize) -> Result<(), MapError> {
        if self.json { self.push(Op::Take { from, member: member as u32 }).map(|_| ()) } else { Ok(()) }
    }

    fn put(&mut self, [_, to]: [u32; 2], member: usize) -> Result<(), MapError> {
        if self.json { self.push(Op::Put { to, member: member as u32 }).map(|_| ()) } else { Ok(()) }
    }

    fn close(&mut self, [from, _]: [u32; 2]) -> Result<(), MapError> {
        if self.json { self.push(Op::Close { from }).map(|_| ()) } else { Ok(()) }
    }
}

/// Returns whether this is the `seq` of a ROS 1 header, which ROS 2 headers lack.
fn is_seq(schema: &Schema, of: &Definition, field: &Field, other: Dialect) -> bool {
    let is_header = of.name.is_message("std_msgs", "Header") && &*field.name == "seq";
    let is_number = field.base == Base::Scalar(Scalar::UInt32) && field.count == Count::One;
    is_header && is_number && schema.dialect() == Dialect::Ros1 && other == Dialect::Ros2
}

/// Returns whether the field names a coordinate frame, as in `tf2`.
fn is_frame(of: &Definition, field: &Field) -> bool {
    let is_text = matches!(field.base, Base::String(_) | Base::WString(_));
    let is_header = of.name.is_message("std_msgs", "Header");
    is_text && (&*field.name == "child_frame_id" || (is_header && &*field.name == "frame_id"))
}

fn excerpt(shape: Shape<'_>) -> String {
    match shape {
        Shape::Scalar { kind, .. } => kind.name().into(),
        Shape::Text(Text { wide: true, .. }) => "wstring".into(),
        Shape::Text(_) => "string".into(),
        Shape::Stamp([(_, Scalar::UInt32), _]) => "time".into(),
        Shape::Stamp(_) => "a time or a duration".into(),
        Shape::Message(definition) => definition.name.to_string(),
    }
}
