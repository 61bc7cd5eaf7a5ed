//! Parses interface definitions of both dialects: `.msg`, `.srv` and `.action`.

mod interface;
mod line;
mod literal;
mod print;
mod text;

pub use crate::dialect::Dialect;

pub use interface::definitions;
pub(crate) use line::parse;
pub(crate) use print::{print_all, type_text};
pub use text::split;

use crate::name::{Kind, TypeName};

/// Longest text of definitions that is read, in bytes: `sensor_msgs` whole, with all its comments,
/// is a tenth of it.
pub const MAX_TEXT: usize = 1 << 20;
/// Most fields, and most constants, of one type.
pub const MAX_FIELDS: usize = 1024;
/// Longest fixed array, and largest bound that means more than none.
pub const MAX_ARRAY: u32 = 1 << 26;

/// One message: a type of its own, or a part of a service or an action.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Definition {
    pub name: TypeName,
    pub constants: Vec<Constant>,
    /// In the order in which they are serialized. Empty for an empty message, also of ROS 2, whose
    /// compilers insert a `structure_needs_at_least_one_member` that has no meaning.
    pub fields: Vec<Field>,
}

#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Constant {
    /// Never [`Base::Named`].
    pub base: Base,
    pub name: Box<str>,
    /// As it was written, without white space around it: part of a ROS 1 md5sum. Checked to be a
    /// value of the type.
    pub text: Box<str>,
}

#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Field {
    pub base: Base,
    pub count: Count,
    pub name: Box<str>,
    /// As it was written, and checked to be a value of the type. ROS 2 nodes begin new messages
    /// with it; nothing else does.
    pub default: Option<Box<str>>,
}

impl Field {
    pub(crate) fn new(base: Base, count: Count, name: &str) -> Self {
        Self { base, count, name: name.into(), default: None }
    }
}

/// How many of a field there are.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Count {
    One,
    /// `[5]`. At least 1, at most [`MAX_ARRAY`].
    Fixed(u32),
    /// `[]`, or with a bound `[<=5]`.
    Sequence(Option<u32>),
}

#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Base {
    Scalar(Scalar),
    /// With its bound in bytes, if any.
    String(Option<u32>),
    /// With its bound in UTF-16 code units, if any.
    WString(Option<u32>),
    /// Built into ROS 1. In ROS 2 `builtin_interfaces/msg/Time` is a message.
    Time,
    /// Built into ROS 1.
    Duration,
    Named(TypeName),
}

/// What has a fixed size.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub enum Scalar {
    Bool,
    /// 8 bits: signed in ROS 1, unsigned in ROS 2.
    Byte,
    /// An unsigned octet in both, of deprecated name.
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

    /// As definitions call it.
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

    /// In bytes, in every binary encoding; also its alignment in CDR.
    pub fn size(self) -> usize {
        match self {
            Self::Bool | Self::Byte | Self::Char | Self::Int8 | Self::UInt8 => 1,
            Self::Int16 | Self::UInt16 => 2,
            Self::Int32 | Self::UInt32 | Self::Float32 => 4,
            Self::Int64 | Self::UInt64 | Self::Float64 => 8,
        }
    }

    /// The same with a name that means one thing in both dialects: what [`Scalar::Byte`] and
    /// [`Scalar::Char`] are.
    pub(crate) fn plain(self, dialect: Dialect) -> Self {
        match (self, dialect) {
            (Self::Byte, Dialect::Ros1) => Self::Int8,
            (Self::Byte, Dialect::Ros2) | (Self::Char, _) => Self::UInt8,
            _ => self,
        }
    }
}

/// A definition that is none, and why.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("{name}{}: {problem}", if *line > 0 { format!(", line {line}") } else { String::new() })]
pub struct DefinitionError {
    /// Of the type, as far as it is known.
    pub name: String,
    /// From 1; 0 where the whole is meant.
    pub line: usize,
    pub problem: Problem,
}

/// What is wrong with a definition, and what would be right.
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

impl Kind {
    /// How many parts a file of this kind has.
    fn parts(self) -> usize {
        match self {
            Self::Message => 1,
            Self::Service => 2,
            Self::Action => 3,
        }
    }
}
