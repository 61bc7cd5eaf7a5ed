//! The client of an etcd cluster, on top of `etcd-client`. Sends each request to one member at a
//! time, with a timeout. Errors name the member and the file at fault.

use std::error::Error as _;
use std::fs::File;
use std::future::Future;
use std::io::{self, Read as _};
use std::path::Path;
use std::time::Duration;

use etcd_client::{
    Certificate, CompareOp, ConnectOptions, Error, EventType, GetOptions, Identity, KvClient, PutOptions, TlsOptions,
    Txn, TxnOp, TxnOpResponse, WatchOptions, WatchStream,
};
use gdp_core::secret_file::{self, SecretFileError};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio::time::timeout;
use tonic::{Code, Status};

use super::kv::{Compare, KeyValue, Op, Outcome, WatchEvent};
use super::{Access, Endpoint, Login, StoreError, Tls};

/// The time limits to connect to one member and for its answer. They leave a leader time to try
/// another member within its lease.
const CONNECT: Duration = Duration::from_secs(1);
const TIMEOUT: Duration = Duration::from_secs(2);

/// The maximum size of one answer, in bytes. A page of items of the largest size fits.
const MAX_ANSWER: usize = 32 << 20;

/// The maximum number of keys in one answer to a listing.
const PAGE: i64 = 256;

/// The maximum size of a file of certificates, a key or a password, in bytes.
const MAX_FILE: usize = 1 << 20;

/// A client of an etcd cluster. It turns to the next member when one does not answer.
#[derive(Clone)]
pub struct EtcdClient {
    endpoints: Vec<Endpoint>,
    access: Access,
    /// The index of the current endpoint.
    at: usize,
    /// The connection. It and its requests are boxed because they are large, and tasks nest many of
    /// them.
    connection: Option<Box<etcd_client::Client>>,
}

/// A stream of the changes under a prefix.
pub struct Watch {
    endpoint: Endpoint,
    access: Access,
    stream: WatchStream,
    /// Keeps the connection of the stream open.
    _connection: Box<etcd_client::Client>,
}

impl EtcdClient {
    /// Checks the files of `access`, without sending a request. `endpoints` has at least one.
    ///
    /// Each connection reads the files again, so renewed certificates need no restart.
    pub fn new(endpoints: &[Endpoint], access: &Access) -> Result<Self, StoreError> {
        connect_options(access)?;
        Ok(Self { endpoints: endpoints.to_vec(), access: access.clone(), at: 0, connection: None })
    }

    /// Returns all keys under `prefix`, and the revision of the listing. Fails if keys and values
    /// exceed `max` bytes.
    pub async fn list(&mut self, prefix: &[u8], max: usize) -> Result<(Vec<KeyValue>, i64), StoreError> {
        let (mut all, mut revision, mut size) = (Vec::<KeyValue>::new(), 0, 0);
        loop {
            let from = all.last().map_or(prefix.to_vec(), |last| [&last.key[..], &[0]].concat());
            let options = GetOptions::new().with_range(end_of(prefix)).with_limit(PAGE).with_revision(revision);
            let get = |connection: etcd_client::Client| {
                let (from, options) = (from.clone(), options.clone());
                async move { kv(&connection).get(from, Some(options)).await }
            };
            let mut answer = self.ask(get).await?;
            if revision == 0 {
                revision = answer.header().map_or(0, |header| header.revision());
            }
            let kvs: Vec<KeyValue> = answer.take_kvs().into_iter().map(Into::into).collect();
            size += kvs.iter().map(|kv| kv.key.len() + kv.value.len()).sum::<usize>();
            if size > max {
                return Err(StoreError::TooMuch(max));
            }
            let is_last = !answer.more() || kvs.is_empty();
            all.extend(kvs);
            if is_last {
                return Ok((all, revision));
            }
        }
    }

    /// Applies `then` if all of `compare` hold, and `otherwise` if not.
    pub async fn transact(
        &mut self,
        compare: &[Compare<'_>],
        then: &[Op<'_>],
        otherwise: &[Op<'_>],
    ) -> Result<Outcome, StoreError> {
        let compare: Vec<etcd_client::Compare> = compare.iter().map(Into::into).collect();
        let ops = |ops: &[Op]| ops.iter().map(TxnOp::from).collect::<Vec<_>>();
        let txn = Txn::new().when(compare).and_then(ops(then)).or_else(ops(otherwise));
        let transact = |connection: etcd_client::Client| {
            let txn = txn.clone();
            async move { kv(&connection).txn(txn).await }
        };
        let answer = self.ask(transact).await?;
        let found = answer.op_responses().into_iter().filter_map(|one| match one {
            TxnOpResponse::Get(mut get) => Some(get.take_kvs().into_iter().next().map(Into::into)),
            _ => None,
        });
        let revision = answer.header().map_or(0, |header| header.revision());
        Ok(Outcome { succeeded: answer.succeeded(), revision, found: found.collect() })
    }

    /// Grants a lease of `ttl` seconds and returns its id.
    pub async fn grant(&mut self, ttl: u64) -> Result<i64, StoreError> {
        let ttl = i64::try_from(ttl).unwrap_or(i64::MAX);
        let grant = |connection: etcd_client::Client| async move { connection.lease_client().grant(ttl, None).await };
        Ok(self.ask(grant).await?.id())
    }

    /// Renews a lease. Returns whether it still exists.
    pub async fn keep_alive(&mut self, lease: i64) -> Result<bool, StoreError> {
        let keep_alive = |connection: etcd_client::Client| async move {
            match connection.lease_client().keep_alive(lease).await {
                Ok(_) => Ok(true),
                // The lease has expired or was revoked.
                Err(Error::LeaseKeepAliveError(_)) => Ok(false),
                Err(error) => Err(error),
            }
        };
        self.ask(keep_alive).await
    }

    /// Revokes a lease and deletes the keys bound to it.
    pub async fn revoke(&mut self, lease: i64) -> Result<(), StoreError> {
        let revoke = |connection: etcd_client::Client| async move { connection.lease_client().revoke(lease).await };
        self.ask(revoke).await.map(drop)
    }

    /// Watches the changes under `prefix` from a revision on.
    pub async fn watch(&mut self, prefix: &[u8], from: i64) -> Result<Watch, StoreError> {
        let (endpoint, access) = (self.endpoint(), self.access.clone());
        let connection = self.connect().await?;
        let options = WatchOptions::new().with_range(end_of(prefix)).with_start_revision(from).with_fragment();
        let mut client = connection.watch_client().max_decoding_message_size(MAX_ANSWER);
        let stream = self.in_time(Box::pin(client.watch(prefix, Some(options)))).await?;
        Ok(Watch { endpoint, access, stream, _connection: connection })
    }

    async fn ask<T, F>(&mut self, request: impl Fn(etcd_client::Client) -> F) -> Result<T, StoreError>
    where
        F: Future<Output = Result<T, Error>>,
    {
        let mut outcome = self.ask_one(&request).await;
        for _ in 1..self.endpoints.len() {
            if !matches!(outcome, Err(StoreError::Unreachable { .. })) {
                break;
            }
            outcome = self.ask_one(&request).await;
        }
        outcome
    }

    /// Sends a request to the current member. Drops the connection if the request fails or its
    /// future is dropped.
    async fn ask_one<T, F>(&mut self, request: &impl Fn(etcd_client::Client) -> F) -> Result<T, StoreError>
    where
        F: Future<Output = Result<T, Error>>,
    {
        let connection = match self.connection.take() {
            Some(connection) => connection,
            None => self.connect().await?,
        };
        let answer = self.in_time(Box::pin(request((*connection).clone()))).await?;
        self.connection = Some(connection);
        Ok(answer)
    }

    async fn connect(&mut self) -> Result<Box<etcd_client::Client>, StoreError> {
        let options = connect_options(&self.access)?;
        let connecting = etcd_client::Client::connect([self.endpoint().to_string()], Some(options));
        self.in_time(Box::pin(connecting)).await.map(Box::new)
    }

    /// Awaits an answer within the time limit. Switches to the next member if this one is
    /// unreachable.
    async fn in_time<T>(&mut self, answer: impl Future<Output = Result<T, Error>>) -> Result<T, StoreError> {
        let endpoint = self.endpoint();
        let error = match timeout(TIMEOUT, answer).await {
            Ok(Ok(answer)) => return Ok(answer),
            Ok(Err(error)) => store_error(&endpoint, &self.access, &error),
            Err(_) => StoreError::Unreachable { endpoint, reason: "no answer in time".into() },
        };
        if matches!(error, StoreError::Unreachable { .. }) {
            self.at = (self.at + 1) % self.endpoints.len();
        }
        Err(error)
    }

    fn endpoint(&self) -> Endpoint {
        self.endpoints[self.at].clone()
    }
}

impl Watch {
    /// Returns the next changes in order, at least one. Never ends except with an error.
    /// Cancel-safe.
    pub async fn next(&mut self) -> Result<Vec<WatchEvent>, StoreError> {
        loop {
            let answer = self.stream.message().await;
            let answer = answer.map_err(|error| store_error(&self.endpoint, &self.access, &error))?;
            let endpoint = self.endpoint.clone();
            let Some(answer) = answer else {
                return Err(StoreError::Unreachable { endpoint, reason: "the watch ended".into() });
            };
            if answer.compact_revision() > 0 {
                return Err(StoreError::Compacted);
            }
            if answer.canceled() {
                let reason = format!("the watch was ended: {}", answer.cancel_reason());
                return Err(StoreError::Refused { endpoint, reason });
            }
            let events = answer.events().iter().filter_map(|event| {
                let kv = event.kv()?.clone().into();
                Some(if event.event_type() == EventType::Delete { WatchEvent::Delete(kv) } else { WatchEvent::Put(kv) })
            });
            let events: Vec<WatchEvent> = events.collect();
            // etcd also confirms the start of the watch.
            if !events.is_empty() {
                return Ok(events);
            }
        }
    }
}

impl From<etcd_client::KeyValue> for KeyValue {
    fn from(kv: etcd_client::KeyValue) -> Self {
        let (create_revision, mod_revision, lease) = (kv.create_revision(), kv.mod_revision(), kv.lease());
        let (key, value) = kv.into_key_value();
        Self { key, value, create_revision, mod_revision, lease }
    }
}

impl From<&Compare<'_>> for etcd_client::Compare {
    fn from(compare: &Compare) -> Self {
        match *compare {
            Compare::Created(key, revision) => Self::create_revision(key, CompareOp::Equal, revision),
            Compare::Modified(key, revision) => Self::mod_revision(key, CompareOp::Equal, revision),
        }
    }
}

impl From<&Op<'_>> for TxnOp {
    fn from(op: &Op) -> Self {
        match *op {
            Op::Put { key, value, lease } => Self::put(key, value, Some(PutOptions::new().with_lease(lease))),
            Op::Delete(key) => Self::delete(key, None),
            Op::Get(key) => Self::get(key, None),
        }
    }
}

fn kv(connection: &etcd_client::Client) -> KvClient {
    connection.kv_client().max_decoding_message_size(MAX_ANSWER)
}

/// Returns the end of the key range with this prefix, exclusive.
fn end_of(prefix: &[u8]) -> Vec<u8> {
    let mut end = prefix.to_vec();
    while let Some(last) = end.pop() {
        if last < 0xff {
            end.push(last + 1);
            return end;
        }
    }
    // To etcd, a zero byte means no end.
    vec![0]
}

fn connect_options(access: &Access) -> Result<ConnectOptions, StoreError> {
    let mut options = ConnectOptions::new().with_connect_timeout(CONNECT).with_auto_token_refresh(true);
    if let Some(tls) = &access.tls {
        options = options.with_tls(tls_options(tls)?);
    }
    if let Some(login) = &access.login {
        options = options.with_user(&login.user, password(login)?);
    }
    Ok(options)
}

fn tls_options(tls: &Tls) -> Result<TlsOptions, StoreError> {
    let ca = certificates(&tls.ca)?;
    let options = TlsOptions::new().ca_certificate(Certificate::from_pem(ca));
    let Some(client) = &tls.client else { return Ok(options) };
    let key = secret_file::read(&client.key, MAX_FILE)?;
    PrivateKeyDer::from_pem_slice(&key).map_err(|error| malformed(&client.key, "no private key in PEM", error))?;
    Ok(options.identity(Identity::from_pem(certificates(&client.cert)?, &key[..])))
}

/// Returns the content of a PEM file whose first certificate is valid.
fn certificates(path: &Path) -> Result<Vec<u8>, StoreError> {
    let io = |action| move |source| SecretFileError::Io { path: path.into(), action, source };
    let mut pem = Vec::new();
    let file = File::open(path).map_err(io("open"))?;
    file.take(MAX_FILE as u64).read_to_end(&mut pem).map_err(io("read"))?;
    CertificateDer::from_pem_slice(&pem).map_err(|error| malformed(path, "no certificate in PEM", error))?;
    Ok(pem)
}

fn password(login: &Login) -> Result<String, StoreError> {
    let path = &login.password_file;
    let content = secret_file::read(path, MAX_FILE)?;
    let text = std::str::from_utf8(&content).map_err(|error| malformed(path, "no text", error))?;
    let password = text.strip_suffix('\n').unwrap_or(text);
    if password.is_empty() || password.contains('\n') {
        return Err(SecretFileError::malformed(path, "a password is one line of text").into());
    }
    Ok(password.into())
}

fn malformed(path: &Path, what: &str, error: impl std::fmt::Display) -> SecretFileError {
    SecretFileError::malformed(path, format!("{what}: {error}"))
}

fn store_error(endpoint: &Endpoint, access: &Access, error: &Error) -> StoreError {
    let endpoint = endpoint.clone();
    match error {
        // A status with a source was created locally, so no answer came.
        Error::GRpcStatus(status) if status.source().is_none() => answered(endpoint, access, status),
        error => StoreError::Unreachable { endpoint, reason: transport_reason(access, error) },
    }
}

/// Converts an error status of etcd.
fn answered(endpoint: Endpoint, access: &Access, status: &Status) -> StoreError {
    let reason = status.message().to_owned();
    match status.code() {
        Code::OutOfRange => StoreError::Compacted,
        // This member has no leader or is about to stop. Another member may answer.
        Code::Unavailable | Code::DeadlineExceeded | Code::Cancelled | Code::Internal | Code::Unknown => {
            StoreError::Unreachable { endpoint, reason }
        }
        Code::InvalidArgument | Code::Unauthenticated | Code::PermissionDenied => {
            let who = match &access.login {
                Some(Login { user, password_file }) => {
                    format!("etcd.user is {user:?}, with the password in {}", password_file.display())
                }
                None => "etcd.user is not set".into(),
            };
            StoreError::Refused { endpoint, reason: format!("{reason} ({who})") }
        }
        _ => StoreError::Refused { endpoint, reason },
    }
}

/// Returns the reason why a member is unreachable, with the file at fault.
fn transport_reason(access: &Access, error: &Error) -> String {
    let (reason, cause) = (chain(error), cause(error));
    let Some(tls) = &access.tls else { return reason };
    if let Some(error @ rustls::Error::InvalidCertificate(_)) = cause.and_then(find) {
        return format!("its certificate does not verify with etcd.ca, {}: {error}", tls.ca.display());
    }
    // With TLS 1.3, the alert about a client certificate may be lost with the connection.
    let is_closed = cause.and_then(find).is_none_or(|error: &io::Error| {
        use io::ErrorKind::{BrokenPipe, ConnectionAborted, ConnectionReset, InvalidData, UnexpectedEof};
        matches!(error.kind(), BrokenPipe | ConnectionAborted | ConnectionReset | InvalidData | UnexpectedEof)
    });
    match &tls.client {
        _ if !is_closed => reason,
        Some(client) => format!("{reason}; it may reject the certificate in etcd.cert, {}", client.cert.display()),
        None => format!("{reason}; it may demand a client certificate: set etcd.cert and etcd.key"),
    }
}

/// Returns the first error of type `T` among an error and its causes.
fn find<'a, T: std::error::Error + 'static>(error: &'a (dyn std::error::Error + 'static)) -> Option<&'a T> {
    // The `source` of an `io::Error` skips the error inside it.
    let inside = error.downcast_ref::<io::Error>().and_then(io::Error::get_ref);
    let inside = inside.map(|inside| inside as &(dyn std::error::Error + 'static));
    error.downcast_ref().or_else(|| inside.or(error.source()).and_then(find))
}

/// Formats an error with its causes.
fn chain(error: &Error) -> String {
    let (mut text, mut cause) = (
        match error {
            Error::GRpcStatus(status) => status.message().to_owned(),
            error => error.to_string(),
        },
        cause(error),
    );
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

/// Returns the cause that `etcd-client` does not expose as a source.
fn cause(error: &Error) -> Option<&(dyn std::error::Error + 'static)> {
    match error {
        Error::GRpcStatus(status) => status.source(),
        Error::TransportError(error) => error.source(),
        _ => None,
    }
}
