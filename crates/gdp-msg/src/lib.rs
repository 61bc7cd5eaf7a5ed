//! Reads and writes ROS messages of any type without generated code. It parses definitions,
//! computes hashes, and transcodes between CDR, ROS 1 serialization and JSON at run time. Its only
//! I/O is loading files. The crate is synchronous and does not depend on the Global Data Plane.
//!
//! A bridge reads the layout of a type from a text. The text is a ROS 1 connection header, a `.msg`
//! file in a share folder, a file from the user, or [`Registry::embedded`], which has the common
//! interfaces. [`Schema::resolve`] collects a message type with all nested types.
//! [`Schema::bundle`] prints a schema as text for a peer without definitions. [`Mapping::new`]
//! compares two schemas once and compiles a flat program. [`Mapping::transcode`] runs the program
//! for each message, directly from the input to the output.
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
//! - `time` maps to `builtin_interfaces/msg/Time`, and `duration` to `…/Duration`. Some of their
//!   numbers are signed in only one dialect. A value that does not fit is refused, not wrapped.
//! - `std_msgs/Header` loses its `seq` towards ROS 2. Towards ROS 1 the caller supplies it
//!   ([`Options::header_seq`]).
//! - Fields pair by name, ignoring case (`K` and `k` of `CameraInfo`). The others pair by position
//!   if both sides have the same number left and their types agree. If one version of a type has
//!   more fields (`Marker`), the mapping drops them, or fills them with zero or empty values;
//!   [`Mapping::notes`] lists them. `ros1_bridge` does the same. Fields left over on both sides, or
//!   between types of different names, make the mapping fail.
//! - `byte` is signed in ROS 1, but has the same eight bits. `string` and `wstring` map to each
//!   other.
//! - A message without fields takes one byte in CDR and none in ROS 1.
//!
//! Every schema works in every encoding: [`Encoding::Cdr`] of a ROS 1 schema has a `seq` in its
//! headers, as its definition says.
//!
//! # Frames
//!
//! A mapping can add a prefix to coordinate frames ([`Mapping::with_frame_prefix`]). It
//! distinguishes the frames of several robots.
//!
//! # Text
//!
//! Binary encodings copy strings without a check, as ROS does. JSON and wide strings are Unicode,
//! so the mapping refuses other text there, including lone surrogates.
//!
//! # JSON
//!
//! A message is one object whose members have the names of the fields. All fields are required, in
//! any order. The form is that of rosbridge, without its losses:
//!
//! - Arrays of `uint8`, `char` and `byte` are base64 strings; the reader also accepts arrays of
//!   numbers.
//! - 64-bit integers beyond ±2^53 are strings, because most JSON readers round them. The reader
//!   also accepts strings for smaller ones.
//! - Special floating-point values are `"NaN"`, `"Infinity"` and `"-Infinity"`. The bits of a NaN
//!   are lost.
//! - A time is an object with the names of the dialect: `secs` and `nsecs`, or `sec` and `nanosec`.
//! - A floating-point number is the shortest text that reads as the same number of its size.
//!
//! # Untrusted input
//!
//! All input is untrusted. Definitions are bounded in length, fields, types and depth. A length in
//! a message may not exceed what the rest of the input can hold. Elements without bytes and the
//! size of the output are bounded too. Memory grows as input is read, never by an announced length
//! alone. An error names the field, the byte offset and the reason. Only the padding of CDR may
//! follow a message.
//!
//! # What is left out
//!
//! - `.idl` files. Of the distributions' packages only `test_msgs` has types without another form.
//! - `long double` and `wchar`, which `.msg` does not have.
//! - XCDR2 and parameter lists, which ROS 2 does not send by default.
//! - Fields in a different order on the two sides.
//! - Default values in messages. They are checked and stored, but not used.
#![deny(unsafe_code)]
// These macros panic if stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod action;
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
pub use action::{Action, ActionError, ActionPart};
pub use definition::{
    Base, Constant, Count, Definition, DefinitionError, Field, MAX_ARRAY, MAX_FIELDS, MAX_TEXT, Problem, Scalar,
};
pub use encode::{Encoding, Fault};
pub use mapping::{MapError, Mapping, Note, Options, TranscodeError};
pub use name::{InterfaceKind, NameError, TypeName};
pub use registry::{AddError, Registry};
pub use schema::{Schema, SchemaError};
pub use share::{LoadError, Loaded};
