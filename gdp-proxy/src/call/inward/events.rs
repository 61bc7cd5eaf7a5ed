//! Follows the events of a remote service or action.

use crate::call::asking::{Described, Known, News};
use futures::stream::FuturesUnordered;
use gdp_wire::Name;
use std::pin::Pin;
use std::sync::Arc;
use std::time::Instant;

/// A server elsewhere.
pub enum Remote {
    Asked,
    Known(Arc<Known>),
    /// It cannot be called, at least until then.
    Unfit(Instant),
}

/// What has come of something that was begun.
pub enum Done {
    Description(Name, Described),
    /// With the event that was had before.
    News(Arc<Known>, u64, News),
    /// Published here, if it was; and whether it is feedback.
    Said(bool, Result<(), String>),
    /// What stood for servers is gone.
    Withdrawn(Result<(), String>),
}

pub type Doing<'a> = FuturesUnordered<Pin<Box<dyn Future<Output = Done> + Send + 'a>>>;
