//! etcd's API version 3, as its gateway takes it: JSON over HTTP (etcd documentation, "gRPC
//! gateway"). Only what the store needs. Numbers of 64 bits are text there, keys and values Base64,
//! and what is zero or empty is left out.

use std::time::Duration;

use base64ct::{Base64, Encoding};
use bytes::{Bytes, BytesMut};
use http_body_util::{BodyExt, Full};
use hyper::body::Incoming;
use hyper::client::conn::http1::{self, SendRequest};
use hyper_util::rt::TokioIo;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio::time::timeout;

use super::{Endpoint, StoreError};

/// How long one member has to take a connection, and to answer: so short that a leader can still
/// ask another one before its lease is over.
const CONNECT: Duration = Duration::from_secs(1);
const TIMEOUT: Duration = Duration::from_secs(2);

/// Bytes of one answer: a page of items of the largest size.
const MAX_ANSWER: usize = 32 << 20;

/// Keys and values in one answer to a listing.
const PAGE: usize = 256;

/// What etcd answers to a watch from a revision that it has compacted, and to a listing of one.
const OUT_OF_RANGE: u64 = 11;

/// A client of an etcd cluster. Asks the next member when one does not answer.
pub struct Gateway {
    endpoints: Vec<Endpoint>,
    /// The one that is asked.
    at: usize,
    connection: Option<SendRequest<Full<Bytes>>>,
}

/// A key and its value, as etcd has them.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
pub struct KeyValue {
    #[serde(deserialize_with = "bytes")]
    pub key: Vec<u8>,
    #[serde(default, deserialize_with = "bytes")]
    pub value: Vec<u8>,
    #[serde(default, deserialize_with = "number")]
    pub create_revision: i64,
    #[serde(default, deserialize_with = "number")]
    pub mod_revision: i64,
    #[serde(default, deserialize_with = "number")]
    pub lease: i64,
}

/// A condition of a transaction, on the revision of a key (0: it is not there).
#[derive(Clone, Debug)]
pub enum Compare<'a> {
    Created(&'a [u8], i64),
    Modified(&'a [u8], i64),
}

/// What a transaction does.
#[derive(Clone, Debug)]
pub enum Op<'a> {
    Put { key: &'a [u8], value: &'a [u8], lease: i64 },
    Delete(&'a [u8]),
    Get(&'a [u8]),
}

/// What came of a transaction.
#[derive(Debug)]
pub struct Outcome {
    pub succeeded: bool,
    pub revision: i64,
    /// What was found for each [`Op::Get`], in their order.
    pub found: Vec<Option<KeyValue>>,
}

/// What has changed at a key.
#[derive(Debug, PartialEq, Eq)]
pub enum Event {
    Put(KeyValue),
    /// The value is empty, the revision that of the deletion.
    Delete(KeyValue),
}

/// A stream of what changes under a prefix.
pub struct Watch {
    endpoint: Endpoint,
    body: Incoming,
    read: BytesMut,
}

impl Gateway {
    /// Asks nobody yet. `endpoints`: at least one.
    pub fn new(endpoints: &[Endpoint]) -> Self {
        Self { endpoints: endpoints.to_vec(), at: 0, connection: None }
    }

    /// All under `prefix`, and of which revision that is. `max`: bytes of keys and values.
    pub async fn list(&mut self, prefix: &[u8], max: usize) -> Result<(Vec<KeyValue>, i64), StoreError> {
        let (mut all, mut revision, mut size) = (Vec::<KeyValue>::new(), 0, 0);
        loop {
            let from = all.last().map_or(prefix.to_vec(), |last| [&last.key[..], &[0]].concat());
            let answer: RangeAnswer = self
                .ask(
                    "/v3/kv/range",
                    &json!({"key": base64(&from), "range_end": base64(&end_of(prefix)), "limit": PAGE.to_string(),
                        "revision": revision.to_string()}),
                )
                .await?;
            if revision == 0 {
                revision = answer.header.revision;
            }
            size += answer.kvs.iter().map(|kv| kv.key.len() + kv.value.len()).sum::<usize>();
            if size > max {
                return Err(StoreError::TooMuch(max));
            }
            let is_last = !answer.more || answer.kvs.is_empty();
            all.extend(answer.kvs);
            if is_last {
                return Ok((all, revision));
            }
        }
    }

    /// Does `then` if all of `compare` hold, and `otherwise` if not.
    pub async fn transact(
        &mut self,
        compare: &[Compare<'_>],
        then: &[Op<'_>],
        otherwise: &[Op<'_>],
    ) -> Result<Outcome, StoreError> {
        let compare: Vec<Value> = compare.iter().map(Compare::json).collect();
        let ops = |ops: &[Op]| ops.iter().map(Op::json).collect::<Vec<_>>();
        let body = json!({"compare": compare, "success": ops(then), "failure": ops(otherwise)});
        let answer: TxnAnswer = self.ask("/v3/kv/txn", &body).await?;
        let found = answer.responses.into_iter().filter_map(|one| one.response_range);
        let found = found.map(|range| range.kvs.into_iter().next()).collect();
        Ok(Outcome { succeeded: answer.succeeded, revision: answer.header.revision, found })
    }

    /// A new lease of so many seconds.
    pub async fn grant(&mut self, ttl: u64) -> Result<i64, StoreError> {
        let answer: Lease = self.ask("/v3/lease/grant", &json!({"TTL": ttl.to_string()})).await?;
        Ok(answer.id)
    }

    /// Has a lease last anew; whether it still does.
    pub async fn keep_alive(&mut self, lease: i64) -> Result<bool, StoreError> {
        let answer: Streamed<Lease> = self.ask("/v3/lease/keepalive", &json!({"ID": lease.to_string()})).await?;
        Ok(answer.result.ttl > 0)
    }

    /// Ends a lease, and what is bound to it.
    pub async fn revoke(&mut self, lease: i64) -> Result<(), StoreError> {
        let _: Value = self.ask("/v3/lease/revoke", &json!({"ID": lease.to_string()})).await?;
        Ok(())
    }

    /// Follows what changes under `prefix` from a revision on.
    pub async fn watch(&mut self, prefix: &[u8], from: i64) -> Result<Watch, StoreError> {
        let request = json!({"create_request": {"key": base64(prefix), "range_end": base64(&end_of(prefix)),
            "start_revision": from.to_string(), "fragment": true}});
        let (endpoint, mut connection) = self.connect().await?;
        let body = self.send(&endpoint, &mut connection, "/v3/watch", &request).await?;
        Ok(Watch { endpoint, body, read: BytesMut::new() })
    }

    async fn ask<T: DeserializeOwned>(&mut self, path: &str, body: &Value) -> Result<T, StoreError> {
        let mut outcome = self.ask_one(path, body).await;
        for _ in 1..self.endpoints.len() {
            if !matches!(outcome, Err(StoreError::Unreachable { .. })) {
                break;
            }
            outcome = self.ask_one(path, body).await;
        }
        outcome
    }

    async fn ask_one<T: DeserializeOwned>(&mut self, path: &str, body: &Value) -> Result<T, StoreError> {
        let (endpoint, mut connection) = match self.connection.take().filter(|connection| !connection.is_closed()) {
            Some(connection) => (self.endpoint(), connection),
            None => self.connect().await?,
        };
        let answer = async {
            let body = self.send(&endpoint, &mut connection, path, body).await?;
            let limited = http_body_util::Limited::new(body, MAX_ANSWER);
            limited.collect().await.map_err(|error| unreachable(&endpoint, error))
        };
        let answer = match timeout(TIMEOUT, answer).await {
            Ok(Ok(answer)) => answer.to_bytes(),
            Ok(Err(error)) => return Err(self.turn(error)),
            Err(_) => return Err(self.turn(unreachable(&endpoint, "no answer in time"))),
        };
        self.connection = Some(connection);
        serde_json::from_slice(&answer).map_err(|error| StoreError::Malformed { endpoint, reason: error.to_string() })
    }

    /// Asks another from now on, if this one does not answer.
    fn turn(&mut self, error: StoreError) -> StoreError {
        if matches!(error, StoreError::Unreachable { .. }) {
            self.at = (self.at + 1) % self.endpoints.len();
        }
        error
    }

    fn endpoint(&self) -> Endpoint {
        self.endpoints[self.at].clone()
    }

    async fn connect(&mut self) -> Result<(Endpoint, SendRequest<Full<Bytes>>), StoreError> {
        let endpoint = self.endpoint();
        let connected = timeout(CONNECT, async {
            let stream = TcpStream::connect((endpoint.host.as_str(), endpoint.port)).await;
            let stream = stream.map_err(|error| unreachable(&endpoint, error))?;
            // A request is one small write, and etcd waits for it.
            let _ = stream.set_nodelay(true);
            http1::handshake(TokioIo::new(stream)).await.map_err(|error| unreachable(&endpoint, error))
        });
        match connected.await {
            Ok(Ok((connection, driver))) => {
                tokio::spawn(driver);
                Ok((endpoint, connection))
            }
            Ok(Err(error)) => Err(self.turn(error)),
            Err(_) => Err(self.turn(unreachable(&endpoint, "no connection in time"))),
        }
    }

    async fn send(
        &self,
        endpoint: &Endpoint,
        connection: &mut SendRequest<Full<Bytes>>,
        path: &str,
        body: &Value,
    ) -> Result<Incoming, StoreError> {
        let host = endpoint.to_string();
        let request = hyper::Request::post(path)
            .header("host", host.trim_start_matches("http://"))
            .header("content-type", "application/json")
            .body(Full::new(Bytes::from(body.to_string())))
            .map_err(|error| StoreError::Malformed { endpoint: endpoint.clone(), reason: error.to_string() })?;
        let response = timeout(TIMEOUT, connection.send_request(request)).await;
        let response = response.map_err(|_| unreachable(endpoint, "no answer in time"))?;
        let response = response.map_err(|error| unreachable(endpoint, error))?;
        let status = response.status();
        if status.is_success() {
            return Ok(response.into_body());
        }
        let limited = http_body_util::Limited::new(response.into_body(), PAGE * 16);
        let said = limited.collect().await.map(|said| said.to_bytes()).unwrap_or_default();
        let said: Said = serde_json::from_slice(&said).unwrap_or_default();
        Err(match said.code {
            OUT_OF_RANGE => StoreError::Compacted,
            // Without a leader of its own, or about to stop: another member may do better.
            _ if status.is_server_error() => unreachable(endpoint, format!("{status} {}", said.error)),
            _ => StoreError::Refused { endpoint: endpoint.clone(), reason: format!("{status} {}", said.error) },
        })
    }
}

impl Watch {
    /// The next changes, in their order, at least one. Never ends but with an error; can be dropped
    /// while it waits.
    pub async fn next(&mut self) -> Result<Vec<Event>, StoreError> {
        loop {
            if let Some(end) = self.read.iter().position(|byte| *byte == b'\n') {
                let line = self.read.split_to(end + 1);
                let malformed = |reason: String| StoreError::Malformed { endpoint: self.endpoint.clone(), reason };
                let Streamed::<WatchAnswer> { result } =
                    serde_json::from_slice(&line).map_err(|error| malformed(error.to_string()))?;
                if result.compact_revision > 0 {
                    return Err(StoreError::Compacted);
                }
                if result.canceled {
                    return Err(malformed(format!("the watch was ended: {}", result.cancel_reason)));
                }
                let events = result.events.into_iter().map(|event| match event.kind.as_deref() {
                    Some("DELETE") => Event::Delete(event.kv),
                    _ => Event::Put(event.kv),
                });
                let events: Vec<Event> = events.collect();
                // It also says that it has begun.
                if events.is_empty() {
                    continue;
                }
                return Ok(events);
            }
            let frame = self.body.frame().await.ok_or_else(|| unreachable(&self.endpoint, "the watch ended"))?;
            let frame = frame.map_err(|error| unreachable(&self.endpoint, error))?;
            if let Ok(data) = frame.into_data() {
                if self.read.len() + data.len() > MAX_ANSWER {
                    return Err(StoreError::TooMuch(MAX_ANSWER));
                }
                self.read.extend_from_slice(&data);
            }
        }
    }
}

impl Compare<'_> {
    fn json(&self) -> Value {
        match self {
            Self::Created(key, revision) => json!({"key": base64(key), "target": "CREATE", "result": "EQUAL",
                "create_revision": revision.to_string()}),
            Self::Modified(key, revision) => json!({"key": base64(key), "target": "MOD", "result": "EQUAL",
                "mod_revision": revision.to_string()}),
        }
    }
}

impl Op<'_> {
    fn json(&self) -> Value {
        match self {
            Self::Put { key, value, lease } => {
                json!({"request_put": {"key": base64(key), "value": base64(value), "lease": lease.to_string()}})
            }
            Self::Delete(key) => json!({"request_delete_range": {"key": base64(key)}}),
            Self::Get(key) => json!({"request_range": {"key": base64(key)}}),
        }
    }
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Header {
    #[serde(deserialize_with = "number")]
    revision: i64,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct RangeAnswer {
    header: Header,
    kvs: Vec<KeyValue>,
    more: bool,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct TxnAnswer {
    header: Header,
    succeeded: bool,
    responses: Vec<OpAnswer>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct OpAnswer {
    response_range: Option<RangeAnswer>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Lease {
    #[serde(rename = "ID", deserialize_with = "number")]
    id: i64,
    #[serde(rename = "TTL", deserialize_with = "number")]
    ttl: i64,
}

#[derive(Deserialize)]
struct Streamed<T> {
    result: T,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct WatchAnswer {
    canceled: bool,
    cancel_reason: String,
    #[serde(deserialize_with = "number")]
    compact_revision: i64,
    events: Vec<WatchEvent>,
}

#[derive(Deserialize)]
struct WatchEvent {
    #[serde(rename = "type")]
    kind: Option<String>,
    kv: KeyValue,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Said {
    error: String,
    code: u64,
}

fn base64(bytes: &[u8]) -> Base64Text<'_> {
    Base64Text(bytes)
}

struct Base64Text<'a>(&'a [u8]);

impl Serialize for Base64Text<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&Base64::encode_string(self.0))
    }
}

fn bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<u8>, D::Error> {
    let text = String::deserialize(deserializer)?;
    Base64::decode_vec(&text).map_err(serde::de::Error::custom)
}

fn number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<i64, D::Error> {
    let text = String::deserialize(deserializer)?;
    text.parse().map_err(serde::de::Error::custom)
}

/// Behind all keys that begin so.
fn end_of(prefix: &[u8]) -> Vec<u8> {
    let mut end = prefix.to_vec();
    while let Some(last) = end.pop() {
        if last < 0xff {
            end.push(last + 1);
            return end;
        }
    }
    // To etcd: without an end.
    vec![0]
}

fn unreachable(endpoint: &Endpoint, reason: impl ToString) -> StoreError {
    StoreError::Unreachable { endpoint: endpoint.clone(), reason: reason.to_string() }
}
