//! Definitions of service types, and converters for requests and responses. [`types`](crate::types)
//! does the same for messages.

use std::sync::Arc;

use gdp_core::card::NameCard;
use gdp_msg::{Mapping, Options, Schema, TypeName, hash};

use crate::call::{Definitions, Description};
use crate::roster::{Dialect, Kind, MAX_DEFINITION};
use crate::types::{Converter, TypeError, Types};

/// The key of a name card's metadata with which the owner marks a service as idempotent. Its value
/// is `true`.
pub const IDEMPOTENT: &str = "idempotent";

/// Whether the owner allows that several servers execute the same call of this service. The name
/// depends on the mark, so only its owner can set it.
pub fn is_idempotent(card: &NameCard) -> bool {
    card.get("kind") == Some("service") && card.get(IDEMPOTENT) == Some("true")
}

/// Converters between a client in one ROS graph and a server in another.
pub struct Converters {
    /// From the client's form to the server's.
    pub request: Converter,
    /// From the server's form to the client's.
    pub response: Converter,
}

/// The schemas of a service: request and response.
pub type Halves = [Arc<Schema>; 2];

/// Returns the name of a service type in another dialect: `std_srvs/SetBool` or
/// `std_srvs/srv/SetBool`.
pub fn service_name(name: &str, dialect: Dialect) -> Result<String, TypeError> {
    let name = TypeName::parse(name)?;
    Ok(match dialect {
        Dialect::Ros1 => format!("{}/{}", name.package(), name.name()),
        Dialect::Ros2 => TypeName::new(name.package(), gdp_msg::InterfaceKind::Service, name.name())?.to_string(),
    })
}

impl Types {
    /// Describes a service type of a ROS graph from the local registry. Uses the hash in `kind`,
    /// which its servers announced, or else computes it.
    pub fn describe_service(&self, kind: Kind) -> Description {
        let halves = self.known_halves(kind.dialect, &kind.name).ok();
        let texts = halves.as_ref().map(|[request, response]| (request.text(), response.text()));
        let short = texts.filter(|(request, response)| request.len().max(response.len()) <= MAX_DEFINITION);
        let definitions = short.map(|(request, response)| Definitions { request, response });
        let hash = if kind.hash.is_empty() { self.service_hash(&kind).unwrap_or_default() } else { kind.hash };
        Description { kind: Kind { hash, ..kind }, node: String::new(), definitions }
    }

    /// Describes a remote service in the terms of `dialect`. The definitions come from the local
    /// registry, or else are made from the description `there`.
    pub fn service_counterpart(&self, there: &Description, dialect: Dialect) -> Result<Description, TypeError> {
        if there.kind.dialect == dialect {
            return Ok(there.clone());
        }
        let name = service_name(&there.kind.name, dialect)?;
        let halves = match self.known_halves(dialect, &name) {
            Ok(halves) => halves,
            Err(_) => {
                let [request, response] = self.service_schemas(there)?;
                [request.in_dialect(dialect.into(), &self.0)?, response.in_dialect(dialect.into(), &self.0)?]
            }
        };
        let hash = match dialect {
            Dialect::Ros1 => digits(&hash::service_md5sum(&halves[0], &halves[1])),
            Dialect::Ros2 => self.type_hash(&name).unwrap_or_default(),
        };
        let [request, response] = halves.map(|half| half.text());
        let definitions = Some(Definitions { request, response });
        Ok(Description { kind: Kind { dialect, name, hash }, node: there.node.clone(), definitions })
    }

    pub fn service_converters(&self, client: &Description, server: &Description) -> Result<Converters, TypeError> {
        if client.kind.dialect == server.kind.dialect {
            return Ok(Converters { request: Converter::None, response: Converter::None });
        }
        let (client, server) = (
            (client.kind.dialect, self.service_schemas(client)?),
            (server.kind.dialect, self.service_schemas(server)?),
        );
        let convert = |half: usize, from: &(Dialect, Halves), to: &(Dialect, Halves)| -> Result<_, TypeError> {
            let (encodings, schemas) = ([from.0.native(), to.0.native()], [&from.1[half], &to.1[half]]);
            let mapping = Mapping::new(schemas[0], encodings[0], schemas[1], encodings[1])?;
            for note in mapping.notes() {
                tracing::info!(from = %schemas[0].name(), to = %schemas[1].name(), "{note}");
            }
            Ok(Converter::Some { mapping, options: Options::default() })
        };
        Ok(Converters { request: convert(0, &client, &server)?, response: convert(1, &server, &client)? })
    }

    /// Returns the schemas of request and response. Uses the definitions that the server announced,
    /// or else the local registry.
    pub fn service_schemas(&self, of: &Description) -> Result<Halves, TypeError> {
        let Kind { dialect, name, .. } = &of.kind;
        let Some(Definitions { request, response }) = &of.definitions else { return self.known_halves(*dialect, name) };
        let [first, second] = TypeName::parse(name)?.service_halves();
        let schema = |name, text| Schema::from_text((*dialect).into(), name, text);
        Ok([schema(&first, request)?, schema(&second, response)?])
    }

    fn known_halves(&self, dialect: Dialect, name: &str) -> Result<Halves, TypeError> {
        let [request, response] = TypeName::parse(name)?.service_halves();
        let known = |name| Schema::resolve(&self.0, dialect.into(), name);
        Ok([known(&request)?, known(&response)?])
    }

    fn service_hash(&self, kind: &Kind) -> Result<Vec<u8>, TypeError> {
        match kind.dialect {
            Dialect::Ros1 => {
                let [request, response] = self.known_halves(kind.dialect, &kind.name)?;
                Ok(digits(&hash::service_md5sum(&request, &response)))
            }
            Dialect::Ros2 => self.type_hash(&kind.name),
        }
    }

    /// Returns the RIHS01 hash of a type of ROS 2: the announced one, or else that of `definition`,
    /// which the sender announced, or else that of the local registry.
    pub fn rihs01(&self, kind: &Kind, definition: Option<&str>) -> Result<Vec<u8>, TypeError> {
        if !kind.hash.is_empty() {
            return Ok(kind.hash.clone());
        }
        Ok(rihs01(&*self.schema(kind, definition)?))
    }

    /// Returns the RIHS01 hash of the type that stands for a whole service or action of ROS 2.
    fn type_hash(&self, name: &str) -> Result<Vec<u8>, TypeError> {
        Ok(rihs01(&*Schema::resolve(&self.0, gdp_msg::Dialect::Ros2, &TypeName::parse(name)?)?))
    }
}

/// Returns the RIHS01 hash of a type of ROS 2, without its prefix.
pub(crate) fn rihs01(schema: &Schema) -> Vec<u8> {
    digits(hash::type_hash(schema).rsplit('_').next().unwrap_or_default())
}

/// Decodes a hash that this program computed, which is hexadecimal.
fn digits(hash: &str) -> Vec<u8> {
    hex::decode(hash).unwrap_or_default()
}

#[cfg(test)]
#[path = "../tests/unit/services.rs"]
mod tests;
