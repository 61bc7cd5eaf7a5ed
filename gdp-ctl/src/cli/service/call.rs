//! `gdp-ctl service call`: sends one request to the nearest server, with values in ROS notation.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context as _, bail};
use clap::Args;
use gdp::unstable::{Client, NodeError};
use gdp_core::card::NameCard;
use gdp_e2e::seal::Message;
use gdp_msg::{Base, Encoding, Mapping, Options as Limits, Schema, TypeName};
use gdp_ros::call::{CALL, Description, Epoch, Part, Reply, Request};
use gdp_util::terminal::note;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

use super::super::node::{Definitions, NodeOptions, unless_interrupted};
use crate::cli::context::Context;
use crate::cli::progress::while_waiting;
use crate::ros::fabric::Fabric;
use crate::ros::fill::fill;
use crate::ros::python;
use crate::ros::user_input::UserInput;
use crate::ros::view::View;
use gdp::unstable::called;
use gdp_util::unix_time::{unix_seconds, unix_time};

/// Timeout, number of attempts, and pause between attempts to get a server's description.
const ATTEMPT: Duration = Duration::from_secs(2);
const ATTEMPTS: u32 = 10;
const SOON: Duration = Duration::from_millis(100);

#[derive(Debug, Args)]
pub struct Options {
    /// Service: a ROS name, a name, the first digits of a name, or a name card.
    #[arg(value_name = "SERVICE")]
    what: String,
    /// Type of the service, such as std_srvs/srv/SetBool.
    #[arg(value_name = "TYPE")]
    type_name: String,
    /// Values of the request's fields, in YAML or JSON. Omitted fields have the default of their
    /// definition, otherwise zero or empty.
    #[arg(default_value = "{}")]
    values: String,
    #[command(flatten)]
    definitions: Definitions,
    #[command(flatten)]
    node: NodeOptions,
}

/// Output of `gdp-ctl service call`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct CallOutput {
    /// The ROS name.
    service: String,
    name: Name,
    server: Name,
    response: Value,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let types = options.definitions.load()?;
    let (given, wanted) = (UserInput::parse(&options.values)?, TypeName::parse(&options.type_name)?);
    let ask = async |fabric: &Fabric, card: &NameCard| {
        let grant = fabric.keyring.grant(card, fabric.node.name(), unix_seconds())?;
        let client = fabric.node.client(card.proof(), grant).await?;
        let server = FoundServer::find(&client, card).await?;
        server.check(&wanted, card)?;
        let [request, response] = types.service_schemas(&server.description)?.map(Half::new);
        let json = fill(&request.schema, &given, (unix_time().as_secs(), unix_time().subsec_nanos()))?;
        if !context.output.json {
            let text = request.text(&json)?;
            context.output.tell(|| format!("requester: making request: {text}"))?;
        }
        let native = server.description.kind.dialect.native();
        let answer = server.call(&client, request.encode(&json, native)?).await?;
        let answer = response.decode(&answer, native)?;
        let text = response.text(&answer)?;
        let (service, name) = (called(card).to_owned(), card.name());
        let output = CallOutput { service, name, server: server.instance, response: answer };
        context.output.print(&output, || [String::new(), "response:".into(), text])
    };
    let ask = async |fabric: &Fabric, card: &NameCard| unless_interrupted(ask(fabric, card)).await;
    options.node.with_card(&options.what, "service", context, ask).map(drop)
}

/// A server of the name, with its description of the service.
struct FoundServer {
    instance: Name,
    epoch: Epoch,
    description: Description,
}

impl FoundServer {
    async fn find(client: &Client, card: &NameCard) -> anyhow::Result<Self> {
        let mut changes = client.changes();
        if client.servers() == 0 {
            note(format_args!("waiting for service {} to become available...", called(card)));
        }
        while client.servers() == 0 {
            changes.changed().await.context("the right to call it has ended")?;
        }
        let asking = format!("asking a server of {} for its description", called(card));
        let reply = while_waiting(&asking, describe(client)).await?;
        match Reply::from_bytes(&reply.body)? {
            Reply::Description(epoch, description) => Ok(Self { instance: reply.writer, epoch, description }),
            Reply::Failure(failure) => bail!("{} is not served: {failure}", called(card)),
            _ => bail!("{:#} answers something else than was asked", reply.writer),
        }
    }

    fn check(&self, wanted: &TypeName, card: &NameCard) -> anyhow::Result<()> {
        let served = &self.description.kind.name;
        let is = TypeName::parse(served)?;
        if (is.package(), is.name()) != (wanted.package(), wanted.name()) {
            bail!("{} is of {served}, and not of {wanted}", called(card));
        }
        Ok(())
    }

    async fn call(&self, client: &Client, body: Vec<u8>) -> anyhow::Result<bytes::Bytes> {
        let request = Request::Call { epoch: self.epoch, part: Part::Service, body: body.into() };
        let reply = client.call_at(self.instance, CALL, &request.to_bytes()).await?;
        match Reply::from_bytes(&reply.body)? {
            Reply::Answer(body) => Ok(body),
            Reply::Failure(failure) => bail!("the call failed: {failure}"),
            _ => bail!("{:#} answers something else than was asked", reply.writer),
        }
    }
}

/// Requests the description repeatedly, because the route to a new server may not exist yet.
async fn describe(client: &Client) -> anyhow::Result<Message> {
    for _ in 0..ATTEMPTS {
        let asked = tokio::time::timeout(ATTEMPT, client.call(CALL, &Request::Describe.to_bytes())).await;
        match asked {
            Ok(Ok(reply)) => return Ok(reply),
            Ok(Err(error @ (NodeError::NoServer(_) | NodeError::NoInstance { .. }))) => tracing::debug!("{error}"),
            Ok(Err(error)) => return Err(error.into()),
            Err(_) => {}
        }
        tokio::time::sleep(SOON).await;
    }
    bail!("its server does not describe it; is it a service of a gdp-proxy?")
}

/// The request or the response type of a service.
struct Half {
    schema: Arc<Schema>,
    root: Base,
}

impl Half {
    fn new(schema: Arc<Schema>) -> Self {
        let root = Base::Named(schema.name().clone());
        Self { schema, root }
    }

    fn text(&self, value: &Value) -> anyhow::Result<String> {
        Ok(python::value(&View::of(&self.schema, &self.root, value))?)
    }

    fn encode(&self, value: &Value, to: Encoding) -> anyhow::Result<Vec<u8>> {
        let mut body = Vec::new();
        let mapping = Mapping::within(&self.schema, Encoding::Json, to)?;
        let encoded = mapping.transcode(value.to_string().as_bytes(), &mut body, &Limits::default());
        encoded.map_err(|error| anyhow::anyhow!("`{}`: {}", error.path, error.fault))?;
        Ok(body)
    }

    fn decode(&self, body: &[u8], from: Encoding) -> anyhow::Result<Value> {
        let mut json = Vec::new();
        let mapping = Mapping::within(&self.schema, from, Encoding::Json)?;
        mapping.transcode(body, &mut json, &Limits::default()).context("what was answered cannot be read")?;
        Ok(serde_json::from_slice(&json)?)
    }
}
