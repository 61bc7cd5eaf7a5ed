//! A topic that this node publishes: its connected subscribers, a queue for each, and the last
//! message if it latches.

use std::collections::HashMap;
use std::sync::Arc;

use bytes::Bytes;
use parking_lot::{Mutex, MutexGuard};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::watch;

use crate::queue::{Queue, QueueLimits};
use crate::tcpros::listener::refuse;
use crate::tcpros::stream::write_message;
use crate::tcpros::{Header, Stream, TcprosError};

/// Maximum number of connections to one topic.
const MAX_SUBSCRIBERS: usize = 1024;

/// The type of a topic, as in connection headers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MessageType {
    /// The name, such as `std_msgs/String`.
    pub name: String,
    /// The MD5 sum of the definition, in hexadecimal.
    pub md5sum: String,
    /// The definition with those of all nested types, as `gendeps --cat` prints it. If it is empty,
    /// tools cannot show the topic.
    pub definition: String,
}

/// The options of a publication.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PublishOptions {
    /// Whether a new subscriber receives the last message.
    pub latch: bool,
    /// The limits of the queue of each subscriber.
    pub queue: QueueLimits,
}

/// A subscriber that is connected to a topic of this node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Subscriber {
    /// The name of its node.
    pub caller_id: String,
    /// Number of messages that its queue dropped.
    pub dropped: u64,
}

pub struct Publication {
    pub topic: String,
    pub kind: MessageType,
    options: PublishOptions,
    caller_id: String,
    subscribers: Mutex<Subscribers>,
    /// Closed when the publication is dropped, which ends its connections.
    alive: watch::Sender<()>,
}

#[derive(Default)]
struct Subscribers {
    connected: HashMap<u64, Connected>,
    next: u64,
    last: Option<Bytes>,
    /// Number of messages that the queues of departed subscribers dropped.
    dropped: u64,
}

struct Connected {
    caller_id: String,
    queue: Arc<Queue<Bytes>>,
}

impl Publication {
    pub fn new(topic: String, kind: MessageType, options: PublishOptions, caller_id: String) -> Self {
        Self { topic, kind, options, caller_id, subscribers: Mutex::default(), alive: watch::channel(()).0 }
    }

    /// Queues a message for each subscriber. A latching publication also stores it for later ones.
    pub fn publish(&self, message: Bytes) {
        let mut subscribers = self.subscribers();
        for connected in subscribers.connected.values() {
            connected.queue.push(message.clone(), message.len());
        }
        if self.options.latch {
            subscribers.last = Some(message);
        }
    }

    pub fn forget_latched(&self) {
        self.subscribers().last = None;
    }

    pub fn connected(&self) -> Vec<Subscriber> {
        let subscriber = |Connected { caller_id, queue }: &Connected| Subscriber {
            caller_id: caller_id.clone(),
            dropped: queue.dropped(),
        };
        self.subscribers().connected.values().map(subscriber).collect()
    }

    /// Returns the number of messages dropped for all subscribers, including departed ones.
    pub fn dropped(&self) -> u64 {
        let subscribers = self.subscribers();
        subscribers.dropped + subscribers.connected.values().map(|connected| connected.queue.dropped()).sum::<u64>()
    }

    /// Sends the topic to a subscriber that connected with `header`, until one side ends.
    pub async fn serve(self: Arc<Self>, stream: Stream, header: Header) -> Result<(), TcprosError> {
        let (queue, id) = match self.accept(&header) {
            Ok(accepted) => accepted,
            Err(reason) => return refuse(stream, &reason).await,
        };
        let mut alive = self.alive.subscribe();
        let _entry = SubscriberEntry { publication: Arc::downgrade(&self), id };
        let ours = self.header().encode();
        drop(self);
        let Stream { mut reader, mut writer } = stream;
        tokio::select! {
            // The channel closes when the publication is dropped; it never carries a value.
            _ = alive.changed() => Ok(()),
            served = async {
                writer.write_all(&ours).await?;
                loop {
                    write_message(&mut writer, &queue.pop().await).await?;
                }
            } => served,
            left = until_closed(&mut reader) => left,
        }
    }

    /// Adds a subscriber, or returns the reason of the refusal.
    fn accept(&self, header: &Header) -> Result<(Arc<Queue<Bytes>>, u64), String> {
        let caller_id = check(header, &self.kind.name, &self.kind.md5sum)?;
        let mut subscribers = self.subscribers();
        if subscribers.connected.len() >= MAX_SUBSCRIBERS {
            return Err(format!("{} has {MAX_SUBSCRIBERS} subscribers, and no room for more", self.topic));
        }
        let queue = Arc::new(Queue::new(self.options.queue));
        if let Some(last) = &subscribers.last {
            queue.push(last.clone(), last.len());
        }
        let id = subscribers.next;
        subscribers.next += 1;
        subscribers.connected.insert(id, Connected { caller_id: caller_id.to_owned(), queue: queue.clone() });
        Ok((queue, id))
    }

    fn header(&self) -> Header {
        let MessageType { name, md5sum, definition } = &self.kind;
        Header::new([
            ("callerid", self.caller_id.as_str()),
            ("latching", if self.options.latch { "1" } else { "0" }),
            ("md5sum", md5sum),
            ("message_definition", definition),
            ("topic", &self.topic),
            ("type", name),
        ])
    }

    fn subscribers(&self) -> MutexGuard<'_, Subscribers> {
        self.subscribers.lock()
    }
}

/// Checks that a peer's connection header asks for this type, and returns its caller ID. The error
/// is a text for the peer.
pub fn check<'a>(header: &'a Header, name: &str, md5sum: &str) -> Result<&'a str, String> {
    let Some(theirs) = header.get("md5sum") else { return Err("Missing required 'md5sum' field".to_owned()) };
    if theirs != "*" && theirs != md5sum {
        let kind = header.get("type").unwrap_or("?");
        return Err(format!("you have {kind} with md5sum {theirs}, and here it is {name} with md5sum {md5sum}"));
    }
    header.get("callerid").ok_or_else(|| "Missing required 'callerid' field".to_owned())
}

/// A subscriber's entry, which removes itself when the connection ends.
struct SubscriberEntry {
    publication: std::sync::Weak<Publication>,
    id: u64,
}

impl Drop for SubscriberEntry {
    fn drop(&mut self) {
        let Some(publication) = self.publication.upgrade() else { return };
        let mut subscribers = publication.subscribers();
        if let Some(connected) = subscribers.connected.remove(&self.id) {
            subscribers.dropped += connected.queue.dropped();
        }
    }
}

/// Waits for the end of the connection. Subscribers send nothing after their header; other bytes
/// are discarded.
async fn until_closed(reader: &mut (impl AsyncReadExt + Unpin)) -> Result<(), TcprosError> {
    let mut nothing = [0; 256];
    while reader.read(&mut nothing).await? > 0 {}
    Ok(())
}
