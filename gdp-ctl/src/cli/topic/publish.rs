//! `gdp-ctl topic pub`: publishes a topic. Like a proxy, it sends a roster, so that remote proxies
//! create a publisher for it in their ROS graphs.

use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use clap::{Args, ValueEnum};
use gdp::unstable::{PublishOptions, Publisher};
use gdp_e2e::seal::Draft;
use gdp_msg::{Base, Encoding, TypeName};
use gdp_ros::encoder::{EncodeError, Encoder};
use gdp_ros::qos_mapping;
use gdp_ros::roster::{self, Offer, Outgoing};
use gdp_ros::types::{Types, sealed};
use gdp_util::terminal::note;
use schemars::JsonSchema;
use serde::Serialize;

use super::super::node::{Definitions, NodeOptions, parse_positive};
use crate::cli::context::Context;
use crate::ros::fabric::Fabric;
use crate::ros::python;
use crate::ros::user_input::UserInput;
use crate::ros::view::View;
use gdp::unstable::called;
use gdp_util::unix_time::unix_seconds;

/// Time that ROS readers behind a proxy need to discover the proxy's publisher, before the first of
/// a few messages.
const DISCOVERY: Duration = Duration::from_secs(1);

/// Maximum time for readers to receive the last messages.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Interval of the checks for readers and for a due roster.
const LOOK: Duration = Duration::from_millis(100);

#[derive(Debug, Args)]
pub struct Options {
    /// Topic: a ROS name, a name, the first digits of a name, or a name card.
    #[arg(value_name = "TOPIC")]
    what: String,
    /// Type of the topic, such as std_msgs/msg/String.
    #[arg(value_name = "TYPE")]
    type_name: String,
    /// Values of fields, in YAML or JSON; `now` is the current time, `auto` a header. Omitted
    /// fields have the default of their definition, otherwise zero or empty.
    #[arg(default_value = "{}")]
    values: String,
    /// Rate, in messages per second.
    #[arg(short, long, default_value_t = 1.0, value_parser = parse_positive)]
    rate: f64,
    /// Publish one message, then exit.
    #[arg(short = '1', long, conflicts_with = "times")]
    once: bool,
    /// Number of messages to publish before exiting. Default: no limit.
    #[arg(short, long)]
    times: Option<u64>,
    /// Number of readers to wait for before publishing. Default: 1 with --once or --times,
    /// otherwise 0.
    #[arg(short, long, value_name = "READERS")]
    wait_matching_subscriptions: Option<usize>,
    /// Offered reliability.
    #[arg(long, value_enum, default_value = "reliable")]
    qos_reliability: Reliable,
    /// Offered durability.
    #[arg(long, value_enum, default_value = "volatile")]
    qos_durability: Durable,
    /// Offered history depth, in messages.
    #[arg(long, default_value_t = 10)]
    qos_depth: u32,
    #[command(flatten)]
    definitions: Definitions,
    #[command(flatten)]
    node: NodeOptions,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
enum Reliable {
    Reliable,
    BestEffort,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
enum Durable {
    Volatile,
    TransientLocal,
}

/// Output of `gdp-ctl topic pub` for each message.
#[derive(Debug, Serialize, JsonSchema)]
pub struct PublishOutput {
    count: u64,
    message: serde_json::Value,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let keyring = options.node.keyring()?;
    let card = keyring.find(&options.what, "topic")?;
    let maker = Maker::new(&options.definitions.load()?, &options.type_name, &options.values)?;
    if let Some(carded) = card.get("type").filter(|text| !text.is_empty())
        && TypeName::parse(carded)? != TypeName::parse(&maker.encoder.kind().name)?
    {
        bail!("{} is of {carded}, and not of {}", called(&card), options.type_name);
    }
    // Check the input before contacting the fabric.
    maker.make()?;
    options.node.with_fabric(keyring, context, async |fabric: &Fabric| {
        let ad = fabric.keyring.ad(&card, fabric.node.name(), unix_seconds())?;
        let offers = offer(options);
        let latched = qos_mapping::latched_depth(&offers);
        let published = PublishOptions { latched, ..qos_mapping::publish_options(&offers) };
        let publisher = fabric.node.publish(card.proof(), ad, published).await?;
        let mut source = Source::new(publisher, &maker, offers);
        tokio::select! {
            done = source.publish(options, context, &maker) => done?,
            interrupted = tokio::signal::ctrl_c() => interrupted.context("cannot wait for ^C")?,
        }
        source.end().await
    })
}

fn offer(options: &Options) -> Offer {
    let (reliable, transient_local) =
        (options.qos_reliability == Reliable::Reliable, options.qos_durability == Durable::TransientLocal);
    Offer {
        reliable,
        transient_local,
        depth: options.qos_depth.max(1),
        deadline_ns: 0,
        lifespan_ns: 0,
        liveliness_ns: 0,
        manual_liveliness: false,
    }
}

/// Creates messages from the user's input.
struct Maker {
    encoder: Encoder,
    input: UserInput,
}

/// A message: encoded, as JSON, and in Python notation.
struct Made {
    body: Vec<u8>,
    json: serde_json::Value,
    text: String,
}

impl Maker {
    fn new(types: &Types, kind: &str, values: &str) -> anyhow::Result<Self> {
        let encoder = Encoder::new(types, kind).map_err(|error| match error {
            EncodeError::Unknown(name, source) => {
                anyhow::Error::from(*source).context(format!("{name} is not known; add --definitions"))
            }
            error => error.into(),
        })?;
        Ok(Self { encoder, input: UserInput::parse(values)? })
    }

    /// Creates a message; `now` in the input becomes the current time.
    fn make(&self) -> anyhow::Result<Made> {
        let (body, json) = self.encoder.encode(&self.input)?;
        let schema = self.encoder.schema();
        let text = python::value(&View::of(schema, &Base::Named(schema.name().clone()), &json))?;
        Ok(Made { body, json, text })
    }
}

/// A publisher with its roster.
struct Source {
    publisher: Publisher,
    roster: Outgoing<()>,
    origin: [u8; 4],
}

impl Source {
    fn new(publisher: Publisher, maker: &Maker, offers: Offer) -> Self {
        let (roster, origin) = roster::single(maker.encoder.kind().clone(), maker.encoder.schema(), offers);
        Self { publisher, roster, origin }
    }

    fn announce(&mut self) -> anyhow::Result<()> {
        Ok(self.roster.announce(Instant::now(), &self.publisher)?)
    }

    async fn publish(&mut self, options: &Options, context: &Context, maker: &Maker) -> anyhow::Result<()> {
        let times = if options.once { Some(1) } else { options.times };
        self.announce()?;
        self.wait(options.wait_matching_subscriptions.unwrap_or(times.is_some().into())).await?;
        let mut due = tokio::time::interval(Duration::from_secs_f64(1.0 / options.rate));
        let mut look = tokio::time::interval(LOOK);
        context.output.tell(|| "publisher: beginning loop".to_owned())?;
        let mut count = 0;
        while times.is_none_or(|times| count < times) {
            tokio::select! {
                _ = due.tick() => {
                    count += 1;
                    let made = maker.make()?;
                    let draft = Draft { origin: &self.origin, ..Draft::new(sealed(Encoding::Cdr), &made.body) };
                    self.publisher.send_batch(&[draft]).await?;
                    let output = PublishOutput { count, message: made.json };
                    context.output.print(&output, || [format!("publishing #{count}: {}", made.text)])?;
                }
                _ = look.tick() => self.announce()?,
            }
        }
        Ok(())
    }

    async fn wait(&mut self, readers: usize) -> anyhow::Result<()> {
        if readers == 0 {
            return Ok(());
        }
        let mut told = false;
        while self.publisher.readers() < readers {
            if !std::mem::replace(&mut told, true) {
                note(format_args!("Waiting for at least {readers} matching subscription(s)..."));
            }
            tokio::time::sleep(LOOK).await;
            self.announce()?;
        }
        tokio::time::sleep(DISCOVERY).await;
        Ok(())
    }

    /// Waits until readers have received all messages, announces that this publisher leaves, and
    /// closes it.
    async fn end(mut self) -> anyhow::Result<()> {
        self.publisher.flush(TIMEOUT).await.context("not everything has arrived")?;
        self.roster.left(&());
        self.announce()?;
        Ok(self.publisher.close(TIMEOUT).await?)
    }
}
