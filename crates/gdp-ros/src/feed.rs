//! Messages of a topic with their publishers' types. Rosters state the types. For writers without
//! rosters, the name's card states the type.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use crate::roster::{Change, Dialect, Incoming, Kind, Offer, RosterEvent};
use crate::types::{TypeError, Types, unsealed};
use gdp::unstable::{Ended, Subscription};
use gdp_core::card::NameCard;
use gdp_e2e::seal::Message;
use gdp_msg::{Base, Encoding, Mapping, Options, Schema};
use gdp_wire::Name;
use serde_json::Value;

/// Interval at which silent publishers are checked.
const LOOK: Duration = Duration::from_secs(1);

/// Known properties of a ROS publisher.
#[derive(Clone, Debug)]
pub struct RemotePublisher {
    pub kind: Kind,
    pub definition: Option<Arc<str>>,
    /// The full name of its node, or an empty text.
    pub node: Arc<str>,
    pub offers: Offer,
}

/// A message with its type.
pub struct ReceivedMessage {
    pub message: Message,
    pub kind: Kind,
    pub definition: Option<Arc<str>>,
}

impl ReceivedMessage {
    /// Returns when the message was sent, by the clock of its source.
    pub fn time(&self) -> SystemTime {
        SystemTime::UNIX_EPOCH + Duration::from_nanos(self.message.timestamp_ns)
    }
}

/// Reads a topic.
pub struct Feed {
    subscription: Subscription,
    incoming: Incoming,
    publishers: BTreeMap<(Name, u32), RemotePublisher>,
    /// Type from the card, for writers without rosters.
    carded: Option<Kind>,
    released: VecDeque<ReceivedMessage>,
    /// Warnings about omitted messages since the last call of [`Self::take_said`].
    said: Vec<String>,
}

impl Feed {
    pub fn new(subscription: Subscription, card: &NameCard) -> Self {
        let carded = card.get("type").filter(|text| !text.is_empty());
        let carded = carded.map(|name| Kind { dialect: Dialect::Ros2, name: name.into(), hash: vec![] });
        Self {
            subscription,
            incoming: Incoming::default(),
            publishers: BTreeMap::new(),
            carded,
            released: VecDeque::new(),
            said: Vec::new(),
        }
    }

    /// Waits until receiving ends, and returns the reason.
    pub fn ended(&self) -> impl Future<Output = Ended> + Send + use<> {
        self.subscription.ended()
    }

    /// Returns the publishers by writer and number.
    pub fn publishers(&self) -> &BTreeMap<(Name, u32), RemotePublisher> {
        &self.publishers
    }

    pub fn take_said(&mut self) -> Vec<String> {
        std::mem::take(&mut self.said)
    }

    /// Returns the next message; `None` once the right to read has ended. Cancel safe.
    pub async fn next(&mut self) -> Option<ReceivedMessage> {
        loop {
            if let Some(received) = self.released.pop_front() {
                return Some(received);
            }
            self.step().await?;
        }
    }

    /// Processes the next message or timer event. Cancel safe.
    pub async fn step(&mut self) -> Option<()> {
        tokio::select! {
            message = self.subscription.recv() => {
                let events = self.incoming.receive(Instant::now(), message?);
                events.into_iter().for_each(|event| self.on_event(event));
            }
            () = tokio::time::sleep(LOOK) => {
                let events = self.incoming.poll(Instant::now());
                events.into_iter().for_each(|event| self.on_event(event));
            }
        }
        Some(())
    }

    fn on_event(&mut self, event: RosterEvent) {
        match event {
            RosterEvent::Changes(changes) => self.change(changes),
            RosterEvent::Message(number, message) => {
                if let Some(RemotePublisher { kind, definition, .. }) =
                    self.publishers.get(&(message.writer, number)).cloned()
                {
                    self.released.push_back(ReceivedMessage { message, kind, definition });
                }
            }
            RosterEvent::Plain(message) => match self.carded.clone() {
                Some(kind) => self.released.push_back(ReceivedMessage { message, kind, definition: None }),
                None => self.said.push(format!(
                    "{:#} does not say of what type its messages are, and the name's card does not either",
                    message.writer
                )),
            },
            RosterEvent::Unannounced(messages) => {
                self.said.push(format!("{messages} messages are left out: their writers do not say of what they are"))
            }
            RosterEvent::Malformed(writer, error) => {
                self.said.push(format!("what {writer:#} says of its publishers is not understood: {error}"))
            }
        }
    }

    fn change(&mut self, changes: Vec<Change>) {
        for change in changes {
            match change {
                Change::Joined { writer, number, kind, definition, node, offers } => {
                    self.publishers.insert((writer, number), RemotePublisher { kind, definition, node, offers });
                }
                Change::Left { writer, number } | Change::Silent { writer, number } => {
                    drop(self.publishers.remove(&(writer, number)))
                }
            }
        }
    }
}

/// Decodes messages to values.
pub struct Decoder {
    types: Types,
    known: HashMap<(Kind, Option<Arc<str>>, Encoding), ReaderConverters>,
}

/// Maximum number of cached converters, one for each kind and encoding.
const MAX_KNOWN: usize = 256;

struct ReaderConverters {
    schema: Arc<Schema>,
    root: Base,
    mapping: Mapping,
}

/// A decoded message.
pub struct Decoded<'a> {
    pub schema: &'a Arc<Schema>,
    /// The message type itself.
    pub root: &'a Base,
    pub value: Value,
}

#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    #[error("messages of {0} cannot be read: {1}; --definitions names share folders that define more types")]
    Type(String, Box<TypeError>),
    #[error("a message that is no {0}: {1}")]
    Message(String, String),
}

impl Decoder {
    pub fn new(types: Types) -> Self {
        Self { types, known: HashMap::new() }
    }

    pub fn decode(&mut self, received: &ReceivedMessage) -> Result<Decoded<'_>, DecodeError> {
        let ReceivedMessage { message, kind, definition } = received;
        let misread = |error: String| DecodeError::Message(kind.name.clone(), error);
        let unsealed = unsealed(message.encoding, message.body.clone());
        let (encoding, body) = unsealed.map_err(|error| misread(error.to_string()))?;
        let key = (kind.clone(), definition.clone(), encoding);
        if self.known.len() >= MAX_KNOWN && !self.known.contains_key(&key) {
            self.known.clear();
        }
        let reader = match self.known.entry(key) {
            std::collections::hash_map::Entry::Occupied(entry) => entry.into_mut(),
            std::collections::hash_map::Entry::Vacant(entry) => {
                let made = ReaderConverters::new(&self.types, received, encoding)
                    .map_err(|error| DecodeError::Type(kind.name.clone(), error.into()))?;
                entry.insert(made)
            }
        };
        let mut json = Vec::new();
        reader.mapping.transcode(&body, &mut json, &Options::default()).map_err(|error| misread(error.to_string()))?;
        let value = serde_json::from_slice(&json).map_err(|error| misread(error.to_string()))?;
        Ok(Decoded { schema: &reader.schema, root: &reader.root, value })
    }
}

impl ReaderConverters {
    fn new(types: &Types, received: &ReceivedMessage, encoding: Encoding) -> Result<Self, TypeError> {
        let ReceivedMessage { kind, definition, .. } = received;
        let schema = types.schema(kind, definition.as_deref())?;
        let mapping = Mapping::within(&schema, encoding, Encoding::Json)?;
        let root = Base::Named(schema.name().clone());
        Ok(Self { schema, root, mapping })
    }
}
