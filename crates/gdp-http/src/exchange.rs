//! A request and its response.

use std::borrow::Cow;

use bytes::Bytes;
use hyper::StatusCode;

/// What a client asks for. It passed the check of [`crate::Access`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HttpRequest {
    /// The path, which begins with `/`, as the client wrote it.
    pub path: String,
    /// The query, without its question mark.
    pub query: String,
    /// What the client wants to get: its `Accept` header, if it has one in ASCII.
    pub accept: Option<String>,
}

impl HttpRequest {
    /// Returns the first value of a query parameter, decoded.
    pub fn parameter(&self, name: &str) -> Option<Cow<'_, str>> {
        form_urlencoded::parse(self.query.as_bytes()).find(|(key, _)| key == name).map(|(_, value)| value)
    }
}

/// What the client gets. The server adds headers against caching, framing and guessing of types.
#[derive(Clone, Debug)]
pub struct HttpResponse {
    pub status: StatusCode,
    pub content_type: &'static str,
    pub body: Bytes,
    /// The `Content-Security-Policy`. The default permits nothing.
    pub policy: &'static str,
}

impl HttpResponse {
    /// A response with status 200.
    pub fn ok(content_type: &'static str, body: impl Into<Bytes>) -> Self {
        Self { status: StatusCode::OK, content_type, body: body.into(), policy: "default-src 'none'" }
    }

    /// A line of text, for a failure.
    pub fn text(status: StatusCode, line: &str) -> Self {
        Self { status, ..Self::ok("text/plain; charset=utf-8", format!("{line}\n")) }
    }

    pub fn not_found() -> Self {
        Self::text(StatusCode::NOT_FOUND, "there is nothing at this path")
    }

    /// A failure that passes.
    pub fn unavailable(why: &str) -> Self {
        Self::text(StatusCode::SERVICE_UNAVAILABLE, why)
    }

    /// Replaces the `Content-Security-Policy`.
    pub fn with_policy(self, policy: &'static str) -> Self {
        Self { policy, ..self }
    }
}
