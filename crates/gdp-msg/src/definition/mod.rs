//! Parses interface definitions of both dialects: `.msg`, `.srv` and `.action`.

pub(crate) mod interface;
mod line;
mod literal;
mod print;
mod text;

pub use crate::dialect::Dialect;

pub use interface::definitions;
pub(crate) use line::parse;
pub(crate) use print::{print_all, type_text};
pub use text::split;

use crate::name::{InterfaceKind, TypeName};

/// Maximum length of a text of definitions, in bytes. All of `sensor_msgs` with its comments takes
/// a tenth of it.
pub const MAX_TEXT: usize = 1 << 20;
/// Maximum number of fields of one type, and of its constants.
pub const MAX_FIELDS: usize = 1024;
/// Maximum length of a fixed array, and maximum bound of a sequence.
pub const MAX_ARRAY: u32 = 1 << 26;

/// The definition of one message: a type of its own, or a part of a service or an action.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Definition {
    pub name: TypeName,
    pub constants: Vec<Constant>,
    /// The fields, in the order of serialization. An empty message has none. In ROS 2, compilers
    /// then insert a `structure_needs_at_least_one_member` without a meaning.
    pub fields: Vec<Field>,
}

#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Constant {
    /// The type, which is never [`Base::Named`].
    pub base: Base,
    pub name: Box<str>,
    /// The value as written, without surrounding white space. It is part of a ROS 1 md5sum, and
    /// valid for the type.
    pub text: Box<str>,
}

#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Field {
    pub base: Base,
    pub count: Count,
    pub name: Box<str>,
    /// The default value as written, valid for the type. Only ROS 2 nodes use it, for new messages.
    pub default: Option<Box<str>>,
}

impl Field {
    pub(crate) fn new(base: Base, count: Count, name: &str) -> Self {
        Self { base, count, name: name.into(), default: None }
    }
}

/// The number of values of a field.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Count {
    One,
    /// `[5]`: at least 1 and at most [`MAX_ARRAY`] values.
    Fixed(u32),
    /// `[]`, or `[<=5]` with a bound.
    Sequence(Option<u32>),
}

#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Base {
    Scalar(Scalar),
    /// A string with its optional bound in bytes.
    String(Option<u32>),
    /// A wide string with its optional bound in UTF-16 code units.
    WString(Option<u32>),
    /// A built-in type of ROS 1. ROS 2 has the message `builtin_interfaces/msg/Time` instead.
    Time,
    /// A built-in type of ROS 1.
    Duration,
    Named(TypeName),
}

/// A type of fixed size.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Scalar {
    Bool,
    /// An octet, signed in ROS 1 and unsigned in ROS 2.
    Byte,
    /// An unsigned octet in both dialects, with a deprecated name.
    Char,
    Int8,
    UInt8,
    Int16,
    UInt16,
    Int32,
    UInt32,
    Int64,
    UInt64,
    Float32,
    Float64,
}

impl Scalar {
    const ALL: [Self; 13] = [
        Self::Bool,
        Self::Byte,
        Self::Char,
        Self::Int8,
        Self::UInt8,
        Self::Int16,
        Self::UInt16,
        Self::Int32,
        Self::UInt32,
        Self::Int64,
        Self::UInt64,
        Self::Float32,
        Self::Float64,
    ];

    /// Returns the name in definitions.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bool => "bool",
            Self::Byte => "byte",
            Self::Char => "char",
            Self::Int8 => "int8",
            Self::UInt8 => "uint8",
            Self::Int16 => "int16",
            Self::UInt16 => "uint16",
            Self::Int32 => "int32",
            Self::UInt32 => "uint32",
            Self::Int64 => "int64",
            Self::UInt64 => "uint64",
            Self::Float32 => "float32",
            Self::Float64 => "float64",
        }
    }

    fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|scalar| scalar.name() == name)
    }

    /// Returns the size in bytes in every binary encoding, which is also the alignment in CDR.
    pub fn size(self) -> usize {
        match self {
            Self::Bool | Self::Byte | Self::Char | Self::Int8 | Self::UInt8 => 1,
            Self::Int16 | Self::UInt16 => 2,
            Self::Int32 | Self::UInt32 | Self::Float32 => 4,
            Self::Int64 | Self::UInt64 | Self::Float64 => 8,
        }
    }

    /// Replaces [`Scalar::Byte`] and [`Scalar::Char`] with the scalar that they mean in `dialect`.
    pub(crate) fn plain(self, dialect: Dialect) -> Self {
        match (self, dialect) {
            (Self::Byte, Dialect::Ros1) => Self::Int8,
            (Self::Byte, Dialect::Ros2) | (Self::Char, _) => Self::UInt8,
            _ => self,
        }
    }
}

/// The error for an invalid definition.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{name}{}: {problem}", if *line > 0 { format!(", line {line}") } else { String::new() })]
pub struct DefinitionError {
    /// The name of the type, as far as it is known.
    pub name: String,
    /// The line, counted from 1, or 0 for the whole text.
    pub line: usize,
    pub problem: Problem,
}

/// A mistake in a definition, with a suggestion.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
pub enum Problem {
    #[error("the text is longer than {MAX_TEXT} bytes: give each package's definitions by themselves")]
    TooLong,
    #[error("more than {MAX_FIELDS} fields or constants: nest what belongs together")]
    TooMany,
    #[error("`{0}` is no field: write `type name`")]
    Incomplete(String),
    #[error("`{0}` is no type of {1}")]
    Type(String, Dialect),
    #[error("`{0}` is no name: use letters, digits and underscores, beginning with a letter")]
    Name(String),
    #[error("`{0}` is there twice: rename one of them")]
    Twice(String),
    #[error("`{0}` is no length of an array: write 1 to {MAX_ARRAY}")]
    Length(String),
    #[error("a ROS 1 field ends with its name, and `{0}` follows it: default values are of ROS 2")]
    Default(String),
    #[error("`{1}` is no value of {0}")]
    Value(String, String),
    #[error("a {0} consists of {1} parts between `---`, and here are {2}")]
    Parts(&'static str, usize, usize),
    #[error("`{0}` begins no definition: after a line of `=`, write `MSG: package/Type`")]
    Header(String),
    #[error("IDL is not read: give the .msg, .srv or .action file that lies beside the .idl file")]
    Idl,
    #[error(transparent)]
    TypeName(#[from] crate::name::NameError),
}

impl DefinitionError {
    fn new(name: &TypeName, line: usize, problem: Problem) -> Self {
        Self { name: name.to_string(), line, problem }
    }
}

impl InterfaceKind {
    /// Returns the number of parts in a file of this kind.
    fn parts(self) -> usize {
        match self {
            Self::Message => 1,
            Self::Service => 2,
            Self::Action => 3,
        }
    }
}
