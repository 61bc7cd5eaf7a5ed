//! Converts messages between the encoding of a graph and the encoding in transit.

use std::sync::Arc;

use bytes::Bytes;
use gdp_e2e::seal;
use gdp_e2e::seal::Message;
use gdp_msg::{Encoding, TranscodeError};

use crate::config::{Compression, FramePrefix, TopicConfig};
use crate::offload::run_blocking_if_large;
use gdp_ros::compression::Packer;
use gdp_ros::roster::Kind;
use gdp_ros::types::{Converter, Form, TypeError, Types, sealed, unsealed};

/// Assumed bound on how many times larger a compressed message becomes when decompressed.
const LIKELY_RATIO: usize = 8;

/// Converts messages of the graph for the fabric.
pub struct Outbound {
    converter: Converter,
    encoding: seal::Encoding,
    packer: Option<Packer>,
}

impl Outbound {
    pub fn new(config: &TopicConfig, types: &Types, kind: &Kind, definition: Option<&str>) -> Result<Self, TypeError> {
        let form = |encoding| Form { kind, definition, encoding };
        let encoding = config.encoding.encoding(kind.dialect);
        let (from, to) = (form(kind.dialect.native()), form(encoding));
        let converter = converter(types, &from, &to, config.frame_prefix.as_ref())?;
        let packer = match config.compression {
            Compression::None => None,
            Compression::Zstd => Some(Packer::new()?),
        };
        Ok(Self { converter, encoding: sealed(encoding), packer })
    }

    /// Returns the encoding of messages if they are carried as they are.
    pub fn unchanged(&self) -> Option<seal::Encoding> {
        (self.converter.is_none() && self.packer.is_none()).then_some(self.encoding)
    }

    pub fn convert(&mut self, bytes: Bytes) -> Result<Bytes, TranscodeError> {
        run_blocking_if_large(bytes.len(), || self.converter.convert(bytes))
    }

    /// Compresses a converted message if the topic is configured so, and returns its encoding and
    /// bytes.
    pub fn pack<'a>(&'a mut self, body: &'a [u8]) -> (seal::Encoding, &'a [u8]) {
        match &mut self.packer {
            Some(packer) => run_blocking_if_large(body.len(), || packer.pack(self.encoding, body)),
            None => (self.encoding, body),
        }
    }
}

/// Converts messages of one remote publisher for the graph.
pub struct Inbound {
    /// The publisher's type, and its counterpart in this graph.
    kinds: (Kind, Kind),
    definitions: (Option<Arc<str>>, Option<String>),
    frame_prefix: Option<FramePrefix>,
    /// One converter for each encoding of messages; nearly always one.
    converters: Vec<(Encoding, Converter)>,
}

impl Inbound {
    /// # Errors
    ///
    /// Fails if a frame prefix is configured and the definition of the type is unknown, so that
    /// nobody knows where its messages contain frames.
    pub fn new(
        types: &Types,
        kinds: (Kind, Kind),
        definitions: (Option<Arc<str>>, Option<String>),
        frame_prefix: Option<FramePrefix>,
    ) -> Result<Self, TypeError> {
        let native = kinds.0.dialect.native();
        let mut new = Self { kinds, definitions, frame_prefix, converters: vec![] };
        if new.frame_prefix.is_some() {
            new.converter(types, native)?;
        }
        Ok(new)
    }

    pub fn convert(&mut self, types: &Types, message: Message) -> Result<Bytes, String> {
        let ratio = if matches!(message.encoding, seal::Encoding::Other(_)) { LIKELY_RATIO } else { 1 };
        run_blocking_if_large(message.body.len() * ratio, || self.convert_here(types, message))
    }

    /// Whether messages in CDR are written as they are.
    pub fn is_unchanged(&mut self, types: &Types) -> bool {
        self.converter(types, Encoding::Cdr).is_ok_and(|converter| converter.is_none())
    }

    fn convert_here(&mut self, types: &Types, message: Message) -> Result<Bytes, String> {
        let unsealed = unsealed(message.encoding, message.body);
        let (encoding, body) = unsealed.map_err(|error| error.to_string())?;
        let converter = self.converter(types, encoding).map_err(|error| error.to_string())?;
        converter.convert(body).map_err(|error| error.to_string())
    }

    fn converter(&mut self, types: &Types, encoding: Encoding) -> Result<&mut Converter, TypeError> {
        let Self { kinds, definitions, frame_prefix, converters } = self;
        let at = match converters.iter().position(|(of, _)| *of == encoding) {
            Some(at) => at,
            None => {
                let from = Form { kind: &kinds.0, definition: definitions.0.as_deref(), encoding };
                let native = kinds.1.dialect.native();
                let to = Form { kind: &kinds.1, definition: definitions.1.as_deref(), encoding: native };
                converters.push((encoding, converter(types, &from, &to, frame_prefix.as_ref())?));
                converters.len() - 1
            }
        };
        Ok(&mut converters[at].1)
    }
}

fn converter(
    types: &Types,
    from: &Form<'_>,
    to: &Form<'_>,
    frame_prefix: Option<&FramePrefix>,
) -> Result<Converter, TypeError> {
    match frame_prefix {
        Some(prefix) => types.prefixing_converter(from, to, prefix.as_str()),
        None => types.converter(from, to),
    }
}

#[cfg(test)]
#[path = "../../tests/unit/route/format.rs"]
mod tests;
