//! Follows the events of a remote service or action.

use crate::call::asking::{Described, Known, News};
use futures::stream::FuturesUnordered;
use gdp_wire::Name;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Instant;

/// The state of a remote server.
pub enum Remote {
    Asked,
    Known(Arc<Known>),
    /// The server cannot be called before this time.
    Unfit(Instant),
}

/// The result of a background task of the route.
pub enum Done {
    Description(Name, Described),
    /// The answer to a request for events, with the event after which it asked.
    News(Arc<Known>, u64, News),
    /// Whether the published message was feedback, and the result of publishing it.
    Said(bool, Result<(), String>),
    /// The result of removing the local server.
    Withdrawn(Result<(), String>),
}

pub type Doing<'a> = FuturesUnordered<Pin<Box<dyn Future<Output = Done> + Send + 'a>>>;
