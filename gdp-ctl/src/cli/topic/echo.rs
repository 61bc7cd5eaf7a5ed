//! `gdp-ctl topic echo`: prints a topic's messages as they arrive.

use std::time::Duration;

use anyhow::bail;
use base64ct::{Base64, Encoding as _};
use clap::Args;
use gdp::unstable::SubscribeOptions;
use gdp_core::card::NameCard;
use gdp_ros::compression::unpacked;
use gdp_util::terminal::note;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

use super::super::node::{Definitions, NodeOptions, listen, parse_positive, tell_if_silent, unless_interrupted};
use super::super::output::lines_of;
use crate::cli::context::Context;
use crate::ros::fabric::Fabric;
use crate::ros::item::Item;
use crate::ros::yaml::document;
use crate::ros::{feed::Decoder, feed::Feed, feed::ReceivedMessage, python, view::Limits, view::View};
use gdp::unstable::called;

#[derive(Debug, Args)]
pub struct Options {
    /// Topic: a ROS name, a name, the first digits of a name, or a name card.
    #[arg(value_name = "TOPIC")]
    what: String,
    /// Print the first message, then exit.
    #[arg(long)]
    once: bool,
    /// Field to print instead of the whole message, such as pose.position.x.
    #[arg(long, value_name = "FIELD", value_parser = parse_path)]
    field: Option<Path>,
    /// Print all elements of arrays and all characters of strings.
    #[arg(short, long)]
    full_length: bool,
    /// Maximum number of array elements and string characters to print.
    #[arg(short = 'l', long, default_value_t = 128, value_name = "LENGTH")]
    truncate_length: usize,
    /// Omit the elements of arrays.
    #[arg(long)]
    no_arr: bool,
    /// Omit the characters of strings.
    #[arg(long)]
    no_str: bool,
    /// Print the bytes of messages, as encoded in the fabric.
    #[arg(long, conflicts_with = "field")]
    raw: bool,
    /// Maximum duration, in seconds. The exit status is 1 if no message has arrived by then.
    #[arg(long, value_name = "SECONDS", value_parser = parse_positive)]
    timeout: Option<f64>,
    #[command(flatten)]
    definitions: Definitions,
    #[command(flatten)]
    node: NodeOptions,
}

#[derive(Clone, Debug)]
struct Path(Vec<String>);

fn parse_path(text: &str) -> Result<Path, String> {
    let fields: Vec<String> = text.split('.').filter(|field| !field.is_empty()).map(str::to_owned).collect();
    if fields.is_empty() { Err("no field; write one as pose.position.x".into()) } else { Ok(Path(fields)) }
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let mut decoder = Decoder::new(options.definitions.load()?);
    let mut echo = async |fabric: &Fabric, card: &NameCard| {
        let mut feed = listen(fabric, card, SubscribeOptions::as_offered()).await?;
        let mut printed = 0u64;
        let all = async {
            tokio::select! {
                done = print_all(options, context, fabric, card, &mut feed, &mut decoder, &mut printed) => done,
                done = tell_if_silent(fabric, card) => done,
            }
        };
        let Some(seconds) = options.timeout else { return all.await };
        match tokio::time::timeout(Duration::from_secs_f64(seconds.min(1e9)), all).await {
            Ok(done) => done,
            Err(_) if printed > 0 => Ok(()),
            Err(_) => {
                bail!("no message of {} came in time; `gdp-ctl topic info` shows who publishes it", called(card))
            }
        }
    };
    let echo = async |fabric: &Fabric, card: &NameCard| unless_interrupted(echo(fabric, card)).await;
    let echoed = options.node.with_card(&options.what, "topic", context, echo);
    echoed.map(drop)
}

async fn print_all(
    options: &Options,
    context: &Context,
    fabric: &Fabric,
    card: &NameCard,
    feed: &mut Feed,
    decoder: &mut Decoder,
    printed: &mut u64,
) -> anyhow::Result<()> {
    while let Some(received) = feed.next().await {
        for said in feed.take_said() {
            note(format_args!("gdp-ctl: {said}"));
        }
        match print(options, context, card, decoder, &received) {
            Ok(()) => *printed += 1,
            // The next message may be from another publisher.
            Err(Failed::Message(error)) => note(format_args!("gdp-ctl: {error}")),
            Err(Failed::Output(error)) => return Err(error),
        }
        if options.once && *printed > 0 {
            return Ok(());
        }
    }
    bail!("{} may not be read any more by {:#}", called(card), fabric.node.name())
}

/// Output of `gdp-ctl topic echo` for each message.
#[derive(Debug, Serialize, JsonSchema)]
pub struct EchoOutput {
    /// The ROS name.
    topic: String,
    name: Name,
    /// The ROS type.
    r#type: String,
    writer: Name,
    sequence: u64,
    /// Send time in Unix time.
    timestamp_ns: u64,
    /// With `--raw`: the number of the encoding.
    #[serde(skip_serializing_if = "Option::is_none")]
    encoding: Option<u16>,
    /// With `--raw`: base64.
    #[serde(skip_serializing_if = "Option::is_none")]
    raw: Option<String>,
    /// Without `--raw`: the message or the selected field.
    #[serde(skip_serializing_if = "Option::is_none")]
    message: Option<Value>,
}

enum Failed {
    Message(anyhow::Error),
    Output(anyhow::Error),
}

fn print(
    options: &Options,
    context: &Context,
    card: &NameCard,
    decoder: &mut Decoder,
    received: &ReceivedMessage,
) -> Result<(), Failed> {
    let message = &received.message;
    let mut output = EchoOutput {
        topic: called(card).to_owned(),
        name: message.name,
        r#type: received.kind.name.clone(),
        writer: message.writer,
        sequence: message.sequence,
        timestamp_ns: message.timestamp_ns,
        encoding: None,
        raw: None,
        message: None,
    };
    if options.raw {
        let unpacked = unpacked(message.encoding, message.body.clone());
        let (encoding, body) = unpacked.map_err(|error| Failed::Message(error.into()))?;
        output.encoding = Some(encoding.into());
        output.raw = Some(Base64::encode_string(&body));
        let text = || [python::bytes(&body), "---".to_owned()];
        return context.output.print(&output, text).map_err(Failed::Output);
    }
    let decoded = decoder.decode(received).map_err(|error| Failed::Message(error.into()))?;
    let path = options.field.as_ref().map_or(&[][..], |path| &path.0);
    // A field that this message lacks is missing in every message.
    let view = View::of(decoded.schema, decoded.root, &decoded.value);
    let view = view.at(path).map_err(|error| Failed::Output(error.into()))?;
    output.message = Some(view.value.clone());
    let length = if options.full_length { usize::MAX } else { options.truncate_length };
    let limits = Limits { length, no_arrays: options.no_arr, no_texts: options.no_str };
    let text = printed(&view, &limits).map_err(Failed::Message)?;
    context.output.print(&output, || lines_of(&format!("{text}---"))).map_err(Failed::Output)
}

/// Returns a message as YAML, or any other value in Python notation.
fn printed(view: &View<'_>, limits: &Limits) -> anyhow::Result<String> {
    let item = view.item(limits)?;
    Ok(match item {
        Item::Map(_) if view.is_message() => document(&item)?,
        Item::Text(text) => format!("{text}\n"),
        Item::Bool(value) => format!("{}\n", if value { "True" } else { "False" }),
        Item::Float(value) => format!("{}\n", python::float(value)),
        other => document(&other)?,
    })
}
