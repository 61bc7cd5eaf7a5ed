//! Message types: what is known of them, and converters from one form to another.

use std::path::Path;
use std::sync::Arc;

use bytes::Bytes;
use gdp::seal;
use gdp_msg::{Encoding, LoadError, MapError, Mapping, NameError, Options, Registry, Schema, SchemaError, TypeName};

use crate::compression::{PackError, UnpackError, unpacked};
use crate::roster::{Dialect, Kind, MAX_DEFINITION};

/// What is known here: the common interfaces, and what was [loaded](Types::load).
pub struct Types(pub(crate) Registry);

/// Messages of a type, laid out in some way.
#[derive(Clone, Debug)]
pub struct Form<'a> {
    pub kind: &'a Kind,
    /// By whoever sends them. Otherwise it must be known here.
    pub definition: Option<&'a str>,
    pub encoding: Encoding,
}

/// Why messages cannot be converted.
#[derive(Debug, thiserror::Error)]
pub enum TypeError {
    #[error(transparent)]
    Name(#[from] NameError),
    #[error(transparent)]
    Schema(#[from] SchemaError),
    #[error(transparent)]
    Map(#[from] MapError),
    #[error("messages in an encoding of number {0}, which this release does not know")]
    Encoding(u16),
    #[error(transparent)]
    Pack(#[from] PackError),
    #[error(transparent)]
    Unpack(#[from] UnpackError),
    #[error("to put a prefix in front of frames, one must know the type: {0}")]
    Frames(Box<TypeError>),
}

/// Turns messages of one form into another.
pub enum Converter {
    /// They are the same.
    None,
    Some {
        mapping: Mapping,
        options: Options,
    },
}

impl From<Dialect> for gdp_msg::Dialect {
    fn from(dialect: Dialect) -> Self {
        match dialect {
            Dialect::Ros1 => Self::Ros1,
            Dialect::Ros2 => Self::Ros2,
        }
    }
}

impl Dialect {
    /// What its nodes exchange.
    pub fn native(self) -> Encoding {
        match self {
            Self::Ros1 => Encoding::Ros1,
            Self::Ros2 => Encoding::Cdr,
        }
    }
}

/// How a message says what it is in.
pub fn sealed(encoding: Encoding) -> seal::Encoding {
    match encoding {
        Encoding::Cdr | Encoding::CdrBigEndian => seal::Encoding::Cdr,
        Encoding::Ros1 => seal::Encoding::Ros1,
        Encoding::Json => seal::Encoding::Json,
    }
}

/// What a message says it is in, and its body in that.
pub fn unsealed(encoding: seal::Encoding, body: Bytes) -> Result<(Encoding, Bytes), TypeError> {
    let (encoding, body) = unpacked(encoding, body)?;
    match encoding {
        seal::Encoding::Cdr => Ok((Encoding::Cdr, body)),
        seal::Encoding::Ros1 => Ok((Encoding::Ros1, body)),
        seal::Encoding::Json => Ok((Encoding::Json, body)),
        other => Err(TypeError::Encoding(other.into())),
    }
}

impl Types {
    /// The common interfaces, and what is in these share folders of installations of ROS; of these, files that define nothing are named in
    /// the log.
    pub fn load<'a>(folders: impl IntoIterator<Item = (Dialect, &'a Path)>) -> Result<Self, LoadError> {
        let mut registry = Registry::embedded();
        for (dialect, folder) in folders {
            let loaded = registry.load_share(dialect.into(), folder)?;
            for error in &loaded.refused {
                tracing::warn!("a definition is left out: {error}");
            }
            tracing::info!(folder = %folder.display(), files = loaded.files, "definitions of messages");
        }
        Ok(Self(registry))
    }

    /// A type that is known here.
    fn known(&self, kind: &Kind) -> Result<Arc<Schema>, TypeError> {
        Ok(Schema::resolve(&self.0, kind.dialect.into(), &TypeName::parse(&kind.name)?)?)
    }

    /// A type by the definition of whoever sends its messages; without one, as it is known here.
    pub fn schema(&self, kind: &Kind, definition: Option<&str>) -> Result<Arc<Schema>, TypeError> {
        match definition {
            Some(text) => Ok(Schema::from_text(kind.dialect.into(), &TypeName::parse(&kind.name)?, text)?),
            None => self.known(kind),
        }
    }

    fn schema_of(&self, form: &Form<'_>) -> Result<Arc<Schema>, TypeError> {
        self.schema(form.kind, form.definition)
    }

    /// The text that a type is defined by with all that it contains, if it is known here and not too long to be told.
    pub fn definition(&self, kind: &Kind) -> Option<String> {
        self.known(kind).ok().map(|schema| schema.text()).filter(|text| text.len() <= MAX_DEFINITION)
    }

    /// The same type in another graph's terms, with the definition that its subscribers need: as it is known here, or else made from that of
    /// the sender.
    pub fn counterpart(&self, form: &Form<'_>, dialect: Dialect) -> Result<(Kind, Option<String>), TypeError> {
        if form.kind.dialect == dialect {
            return Ok((form.kind.clone(), form.definition.map(str::to_owned)));
        }
        let name = TypeName::parse(&form.kind.name)?.display(dialect.into());
        let kind = Kind { dialect, name, hash: vec![] };
        let schema = match self.known(&kind) {
            Ok(schema) => schema,
            Err(_) => self.schema_of(form)?.in_dialect(dialect.into(), &self.0)?,
        };
        Ok((kind, Some(schema.text())))
    }

    /// What ROS 1 compares of a type of its own.
    pub fn md5sum(&self, kind: &Kind, definition: Option<&str>) -> Result<String, TypeError> {
        if !kind.hash.is_empty() {
            return Ok(hex::encode(&kind.hash));
        }
        Ok(gdp_msg::hash::md5sum(&*self.schema(kind, definition)?))
    }

    pub fn converter(&self, from: &Form<'_>, to: &Form<'_>) -> Result<Converter, TypeError> {
        if from.encoding == to.encoding && from.kind.dialect == to.kind.dialect {
            return Ok(Converter::None);
        }
        self.mapped(from, to, "")
    }

    /// The same, and `prefix` goes in front of all coordinate frames; see [`Mapping::with_frame_prefix`].
    pub fn prefixing_converter(&self, from: &Form<'_>, to: &Form<'_>, prefix: &str) -> Result<Converter, TypeError> {
        let converter = self.mapped(from, to, prefix).map_err(|error| TypeError::Frames(error.into()))?;
        match &converter {
            Converter::Some { mapping, .. } if !mapping.prefixes_frames() => {
                tracing::info!(kind = %from.kind.name, "it has no frames that could have a prefix");
                self.converter(from, to)
            }
            _ => Ok(converter),
        }
    }

    fn mapped(&self, from: &Form<'_>, to: &Form<'_>, prefix: &str) -> Result<Converter, TypeError> {
        let (of, into) = (self.schema_of(from)?, self.schema_of(to)?);
        let mapping = Mapping::with_frame_prefix(&of, from.encoding, &into, to.encoding, prefix)?;
        for note in mapping.notes() {
            tracing::info!(from = %from.kind.name, to = %to.kind.name, "{note}");
        }
        Ok(Converter::Some { mapping, options: Options::default() })
    }
}

impl Converter {
    /// Of a message in the one form that in the other.
    pub fn convert(&mut self, bytes: Bytes) -> Result<Bytes, gdp_msg::TranscodeError> {
        match self {
            Self::None => Ok(bytes),
            Self::Some { mapping, options } => {
                options.header_seq = options.header_seq.wrapping_add(1);
                let mut output = Vec::new();
                mapping.transcode(&bytes, &mut output, options)?;
                Ok(output.into())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(dialect: Dialect, name: &str) -> Kind {
        Kind { dialect, name: name.into(), hash: vec![] }
    }

    #[test]
    fn what_one_ros_version_says_the_other_understands() {
        let types = Types::load([]).unwrap();
        let ros1 = kind(Dialect::Ros1, "std_msgs/String");
        let from = Form { kind: &ros1, definition: Some("string data\n"), encoding: Encoding::Ros1 };
        let (ros2, definition) = types.counterpart(&from, Dialect::Ros2).unwrap();
        assert_eq!(ros2.name, "std_msgs/msg/String");
        let to = Form { kind: &ros2, definition: definition.as_deref(), encoding: Encoding::Cdr };
        let mut there = types.converter(&from, &to).unwrap();
        let mut back = types.converter(&to, &from).unwrap();
        let message = Bytes::from_static(b"\x02\0\0\0hi");
        let cdr = there.convert(message.clone()).unwrap();
        assert_eq!(&cdr[..], b"\0\x01\0\0\x03\0\0\0hi\0");
        assert_eq!(back.convert(cdr).unwrap(), message);
        assert!(there.convert(Bytes::from_static(b"\xff\0\0\0hi")).is_err());

        let own = kind(Dialect::Ros1, "my_robot/Unheard");
        let from = Form { kind: &own, definition: Some("time stamp\n"), encoding: Encoding::Ros1 };
        let (kind, definition) = types.counterpart(&from, Dialect::Ros2).unwrap();
        assert_eq!(kind.name, "my_robot/msg/Unheard");
        assert!(definition.unwrap().starts_with("builtin_interfaces/Time stamp\n"));
    }

    #[test]
    fn frames_get_a_prefix_where_the_type_has_some_and_is_known() {
        let types = Types::load([]).unwrap();
        let form = |kind, definition| Form { kind, definition, encoding: Encoding::Cdr };
        let header = kind(Dialect::Ros2, "std_msgs/msg/Header");
        let header = form(&header, None);
        let mut converter = types.prefixing_converter(&header, &header, "r1/").unwrap();
        let message = Bytes::from_static(b"\0\x01\0\0\x01\0\0\0\x02\0\0\0\x04\0\0\0map\0");
        let expected = b"\0\x01\0\0\x01\0\0\0\x02\0\0\0\x07\0\0\0r1/map\0";
        assert_eq!(&converter.convert(message).unwrap()[..], expected);

        let string = kind(Dialect::Ros2, "std_msgs/msg/String");
        let string = form(&string, None);
        assert!(matches!(types.prefixing_converter(&string, &string, "r1/"), Ok(Converter::None)), "as fast as before");
        let own = kind(Dialect::Ros2, "my_robot/msg/Unheard");
        let refusal = types.prefixing_converter(&form(&own, None), &form(&own, None), "r1/").err().unwrap().to_string();
        assert!(refusal.contains("must know the type") && refusal.contains("my_robot/msg/Unheard"), "{refusal}");
        let defined = form(&own, Some("string child_frame_id\n"));
        assert!(matches!(types.prefixing_converter(&defined, &defined, "r1/"), Ok(Converter::Some { .. })));
    }

    #[test]
    fn what_is_the_same_needs_no_definition() {
        let own = kind(Dialect::Ros2, "my_robot/msg/Unheard");
        let form = Form { kind: &own, definition: None, encoding: Encoding::Cdr };
        assert!(matches!(Types::load([]).unwrap().converter(&form, &form), Ok(Converter::None)));
        let json = Form { encoding: Encoding::Json, ..form.clone() };
        let refusal = Types::load([]).unwrap().converter(&form, &json).err().unwrap().to_string();
        assert!(refusal.contains("my_robot/msg/Unheard"), "{refusal}");
        let defined = Form { definition: Some("int32 a\nstring b\n"), ..form };
        let json = Form { encoding: Encoding::Json, ..defined.clone() };
        let mut converter = Types::load([]).unwrap().converter(&json, &defined).unwrap();
        let cdr = converter.convert(Bytes::from_static(br#"{"a":7,"b":"x"}"#)).unwrap();
        assert_eq!(&cdr[..], b"\0\x01\0\0\x07\0\0\0\x02\0\0\0x\0");
    }
}
