//! ROS messages of any type, without generated code: definitions, hashes, and transcoding between
//! CDR, ROS 1 serialization and JSON at run time. The only I/O is loading files. The crate is
//! synchronous, and depends on nothing of the Global Data Plane.
//!
//! A bridge learns what a type looks like from text: a ROS 1 connection header, a `.msg` file in a
//! share folder, a file that the user gives, or [`Registry::embedded`], which has the common
//! interfaces. [`Schema::resolve`] collects a message with all that it consists of;
//! [`Schema::bundle`] is that as text, for a far side that has no definitions. [`Mapping::new`]
//! compares two schemas once and makes a flat program; [`Mapping::transcode`] runs it over each
//! message, from the input straight to the output.
//!
//! ```
//! use gdp_msg::{Dialect, Encoding, Mapping, Options, Registry, Schema, TypeName};
//!
//! let registry = Registry::embedded();
//! let name = TypeName::parse("geometry_msgs/PointStamped")?;
//! let ros1 = Schema::resolve(&registry, Dialect::Ros1, &name)?;
//! let ros2 = Schema::resolve(&registry, Dialect::Ros2, &name)?;
//! let mapping = Mapping::new(&ros2, Encoding::Json, &ros1, Encoding::Ros1)?;
//! let json = br#"{"header": {"stamp": {"sec": 7, "nanosec": 5}, "frame_id": "map"}, "point": {"x": 1.5, "y": 0, "z": "NaN"}}"#;
//! let mut bytes = Vec::new();
//! mapping.transcode(json, &mut bytes, &Options { header_seq: 42, ..Options::default() })?;
//! assert_eq!(bytes[..12], [42, 0, 0, 0, 7, 0, 0, 0, 5, 0, 0, 0]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Between ROS 1 and ROS 2
//!
//! - `time` is `builtin_interfaces/msg/Time`, `duration` is `…/Duration`. Their seconds are signed
//!   in one and not in the other; what does not fit is refused, not wrapped.
//! - `std_msgs/Header` loses its `seq` towards ROS 2, and gets the caller's
//!   ([`Options::header_seq`]) towards ROS 1.
//! - Fields pair by name, whatever its case (`K` and `k` of `CameraInfo`), or by position if as
//!   many are left on both sides and their types agree. If one side's version of a type has more
//!   fields (`Marker`), these are dropped, or zero and empty; [`Mapping::notes`] says which.
//!   `ros1_bridge` does the same. What is left over on both sides, or of two types of different
//!   names, is refused.
//! - `byte` is signed in ROS 1: the same eight bits. `string` and `wstring` map to each other.
//! - A message without fields is one byte of CDR and none of ROS 1.
//!
//! Any schema can be had in any encoding: [`Encoding::Cdr`] of a ROS 1 schema has a `seq` in its
//! headers, as its definition says.
//!
//! # Frames
//!
//! On the way, coordinate frames can get a prefix ([`Mapping::with_frame_prefix`]), so that those
//! of several robots are told apart.
//!
//! # Text
//!
//! Binary encodings pass on whatever a sender took for a string, as ROS does. JSON and wide strings
//! are Unicode: other text is refused there, and so are lone surrogates.
//!
//! # JSON
//!
//! One object for each message, its members named as the fields, all of them, in any order. As
//! rosbridge writes it, with what rosbridge loses:
//!
//! - Arrays of `uint8`, `char` and `byte` are base64 strings; arrays of numbers are read as well.
//! - 64-bit integers beyond ±2^53 are strings, because most readers of JSON round them; strings are
//!   read for smaller ones, too.
//! - What is no number is `"NaN"`, `"Infinity"` or `"-Infinity"`. The bits of a NaN are not kept.
//! - A time is an object with the names of the dialect: `secs` and `nsecs`, `sec` and `nanosec`.
//! - Floating point numbers are the shortest text that reads as the same number of their size.
//!
//! # What is hostile
//!
//! Everything: texts of definitions are bounded in length, fields, types and depth; messages in
//! what their lengths may claim (never more than the rest of the input can hold), in elements that
//! take no bytes, and in what they may grow to. Memory is taken as input is read, never for a
//! length that was only claimed. A refusal says which field, at which byte, and why. Nothing may
//! follow a message but the padding of CDR.
//!
//! # What is left out
//!
//! `.idl` files: of the distributions' packages only `test_msgs` has types that exist in no other
//! form. `long double` and `wchar`, which `.msg` does not have. XCDR2 and parameter lists, which
//! ROS 2 does not send by default. Fields in another order on the two sides. Default values are
//! checked and kept, but no message is filled in with them.
#![deny(unsafe_code)]
// They panic where stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod definition;
mod dialect;
mod embedded;
mod encode;
pub mod hash;
mod mapping;
mod name;
mod registry;
mod schema;
mod share;
mod translate;

pub use crate::dialect::Dialect;
pub use definition::{
    Base, Constant, Count, Definition, DefinitionError, Field, MAX_ARRAY, MAX_FIELDS, MAX_TEXT, Problem, Scalar,
};
pub use encode::{Encoding, Fault};
pub use mapping::{MapError, Mapping, Note, Options, TranscodeError};
pub use name::{Kind, NameError, TypeName};
pub use registry::{AddError, Registry};
pub use schema::{Schema, SchemaError};
pub use share::{LoadError, Loaded};
