//! A small HTTP server for what people and monitors look at: metrics and pages, GET only.
//!
//! - [`access`]: who may ask: everybody on this machine, or who presents a token
//! - [`address`]: the address of a listener, on loopback unless it says otherwise
//! - [`error`]: reasons why a listener does not start
//! - [`metrics`]: metrics in the formats of Prometheus and OpenMetrics
//! - [`server`]: the listener, bounded in connections, bytes and time
//! - [`exchange`]: a request and its response
//!
//! A page of another site can make a browser send requests to a loopback address under a name of
//! that site. The server therefore answers only for IP addresses and `localhost`, unless the
//! request has the token in its `Authorization` header, which no such page knows.
#![deny(unsafe_code)]

pub mod access;
pub mod address;
pub mod error;
pub mod exchange;
pub mod metrics;
pub mod server;

pub use access::{Access, AccessToken};
pub use address::parse_address;
pub use error::HttpError;
pub use exchange::{HttpRequest, HttpResponse};
pub use hyper::StatusCode;
pub use server::{Listener, serve};
