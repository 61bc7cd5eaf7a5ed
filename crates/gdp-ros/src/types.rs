//! Definitions of message types, and converters between types and encodings.

use std::path::Path;
use std::sync::Arc;

use bytes::Bytes;
use gdp_e2e::seal;
use gdp_msg::{Encoding, LoadError, MapError, Mapping, NameError, Options, Registry, Schema, SchemaError, TypeName};

use crate::compression::{PackError, UnpackError, unpacked};
use crate::roster::{Dialect, Kind, MAX_DEFINITION};

/// A registry of message definitions: the embedded common interfaces, and the definitions that
/// [`Types::load`] read.
pub struct Types(pub(crate) Registry);

/// The type and the encoding of a stream of messages.
#[derive(Clone, Debug)]
pub struct Form<'a> {
    pub kind: &'a Kind,
    /// The definition that the sender announced. If it is `None`, the local registry must know the
    /// type.
    pub definition: Option<&'a str>,
    pub encoding: Encoding,
}

/// The reason why messages cannot be converted.
#[derive(Debug, thiserror::Error)]
pub enum TypeError {
    #[error(transparent)]
    Name(#[from] NameError),
    #[error(transparent)]
    Schema(#[from] SchemaError),
    #[error(transparent)]
    Map(#[from] MapError),
    #[error(transparent)]
    Action(#[from] gdp_msg::ActionError),
    #[error("messages in an encoding of number {0}, which this release does not know")]
    Encoding(u16),
    #[error(transparent)]
    Pack(#[from] PackError),
    #[error(transparent)]
    Unpack(#[from] UnpackError),
    #[error("to put a prefix in front of frames, one must know the type: {0}")]
    Frames(Box<TypeError>),
}

/// Converts messages from one form to another.
pub enum Converter {
    /// Both forms have the same bytes.
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
    /// Returns the encoding that ROS nodes of this dialect exchange.
    pub fn native(self) -> Encoding {
        match self {
            Self::Ros1 => Encoding::Ros1,
            Self::Ros2 => Encoding::Cdr,
        }
    }
}

/// Returns the encoding number that a sealed message carries for `encoding`. Both byte orders of
/// CDR have the same number.
pub fn sealed(encoding: Encoding) -> seal::Encoding {
    match encoding {
        Encoding::Cdr | Encoding::CdrBigEndian => seal::Encoding::Cdr,
        Encoding::Ros1 => seal::Encoding::Ros1,
        Encoding::Json => seal::Encoding::Json,
    }
}

/// Returns the encoding and the body of a sealed message, decompressed if it was compressed.
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
    /// Loads the embedded interfaces and the definitions in `folders`, which are share folders of
    /// ROS installations. Logs a warning for each file without a valid definition.
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

    /// Returns the schema of a type from the local registry.
    fn known(&self, kind: &Kind) -> Result<Arc<Schema>, TypeError> {
        Ok(Schema::resolve(&self.0, kind.dialect.into(), &TypeName::parse(&kind.name)?)?)
    }

    /// Returns the schema of a type. Uses `definition`, which the sender announced, or else the
    /// local registry.
    pub fn schema(&self, kind: &Kind, definition: Option<&str>) -> Result<Arc<Schema>, TypeError> {
        match definition {
            Some(text) => Ok(Schema::from_text(kind.dialect.into(), &TypeName::parse(&kind.name)?, text)?),
            None => self.known(kind),
        }
    }

    fn schema_of(&self, form: &Form<'_>) -> Result<Arc<Schema>, TypeError> {
        self.schema(form.kind, form.definition)
    }

    /// Returns the definition of a type from the local registry, with all nested types. Returns
    /// `None` if the registry does not know the type or the text exceeds [`MAX_DEFINITION`] bytes.
    pub fn definition(&self, kind: &Kind) -> Option<String> {
        self.known(kind).ok().map(|schema| schema.text()).filter(|text| text.len() <= MAX_DEFINITION)
    }

    /// Returns the type in the terms of `dialect`, with the definition that subscribers there need.
    /// The definition comes from the local registry, or else is made from the sender's definition.
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

    /// Returns the MD5 sum that ROS 1 nodes compare for a type of ROS 1.
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

    /// Returns a converter that also adds `prefix` to all coordinate frames; see
    /// [`Mapping::with_frame_prefix`].
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
    /// Whether messages stay as they are.
    pub fn is_none(&self) -> bool {
        matches!(self, Self::None)
    }

    /// Converts one message to the other form.
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
#[path = "../tests/unit/types.rs"]
mod tests;
