//! The JSON schema of the commands' output with `-j`: `gdp-ctl --schema`.

use gdp_proto::admin::Versioned;
use gdp_proto::admin::event::TimedEvent;
use gdp_proto::admin::links::{LinksReply, PeersReply};
use gdp_proto::admin::topology::TopologyReply;
use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde_json::{Map, Value};

use super::credential_file::{CertificateOutput, IssuedOutput};
use super::output::FailureOutput;
use super::revocation::RevokeOutput;
use super::{
    advertise, doctor, domain, dump, grant, home, key, name, ping, query, service, status, topic, trace, web, xdp,
};

type Of = fn(&mut SchemaGenerator) -> Schema;

/// Output type of each command: a single object, or one object on each line.
const OUTPUTS: [(&str, Of); 54] = [
    ("error", of::<FailureOutput>),
    ("invite", of::<home::InviteOutput>),
    ("approve", of::<home::DecisionOutput>),
    ("deny", of::<home::DecisionOutput>),
    ("robots", of::<home::RobotsOutput>),
    ("revoke", of::<RevokeOutput>),
    ("apply", of::<home::ApplyOutput>),
    ("admin backup", of::<home::BackupOutput>),
    ("admin restore", of::<home::BackupOutput>),
    ("admin rotate", of::<home::RotationOutput>),
    ("admin log", of::<home::LogOutput>),
    ("status", of::<status::StatusOutput>),
    ("web", of::<web::WebOutput>),
    ("link list", of::<LinksReply>),
    ("peer list", of::<PeersReply>),
    ("topology", of::<TopologyReply>),
    ("monitor", of::<TimedEvent>),
    ("fib dump", of::<dump::FibOutput>),
    ("rib dump", of::<dump::RibOutput>),
    ("trace", of::<trace::TraceOutput>),
    ("ping", of::<ping::PingOutput>),
    ("query", of::<query::QueryOutput>),
    ("advertise", of::<advertise::AdvertiseOutput>),
    ("withdraw", of::<advertise::AdvertiseOutput>),
    ("key generate", of::<key::NewKeyOutput>),
    ("key show", of::<key::KeyOutput>),
    ("name create", of::<name::CardOutput>),
    ("name derive", of::<name::CardOutput>),
    ("name show", of::<name::CardOutput>),
    ("cert show", of::<CertificateOutput>),
    ("grant add", of::<IssuedOutput>),
    ("grant renew", of::<IssuedOutput>),
    ("grant list", of::<grant::GrantsOutput>),
    ("grant revoke", of::<RevokeOutput>),
    ("domain init", of::<domain::InitOutput>),
    ("domain admit", of::<IssuedOutput>),
    ("domain invite", of::<IssuedOutput>),
    ("domain join", of::<domain::JoinOutput>),
    ("domain peer", of::<IssuedOutput>),
    ("domain revoke", of::<RevokeOutput>),
    ("domain show", domain_show),
    ("topic list", of::<topic::ListOutput>),
    ("topic info", of::<topic::InfoOutput>),
    ("topic echo", of::<topic::EchoOutput>),
    ("topic hz", of::<topic::RateOutput>),
    ("topic bw", of::<topic::BandwidthOutput>),
    ("topic delay", of::<topic::DelayOutput>),
    ("topic pub", of::<topic::PublishOutput>),
    ("service list", of::<topic::ListOutput>),
    ("service call", of::<service::CallOutput>),
    ("action list", of::<topic::ListOutput>),
    ("doctor", of::<doctor::DoctorOutput>),
    ("xdp stats", of::<xdp::StatsOutput>),
    ("xdp detach", of::<xdp::DetachOutput>),
];

/// Returns the schema of an object with a property for each command, which describes the command's
/// output.
pub fn schema() -> Schema {
    let mut generator = SchemaSettings::draft2020_12().for_serialize().into_generator();
    let outputs: Map<_, _> =
        OUTPUTS.iter().map(|(verb, of)| ((*verb).to_owned(), Value::from(of(&mut generator)))).collect();
    json_schema!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "gdp-ctl -j",
        "description": "What each command prints with -j, one object a line. `error` is what any command prints that \
                        fails, unless its own output shows the failure.",
        "properties": outputs,
        "$defs": generator.take_definitions(true),
    })
}

fn of<T: JsonSchema>(generator: &mut SchemaGenerator) -> Schema {
    Versioned::<T>::json_schema(generator)
}

/// Returns the schema by the kind of argument: a domain's card, an invitation or a certificate.
fn domain_show(generator: &mut SchemaGenerator) -> Schema {
    let shown: [Of; 3] = [of::<domain::DomainOutput>, of::<domain::InvitationOutput>, of::<CertificateOutput>];
    json_schema!({"anyOf": shown.map(|of| of(generator))})
}

#[cfg(test)]
#[path = "../../tests/unit/cli/schema.rs"]
mod tests;
