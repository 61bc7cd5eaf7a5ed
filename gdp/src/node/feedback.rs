//! The switch's error reports about the frames of publishers.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::SystemTime;

use gdp_wire::{ErrorCode, Header, Name};
use parking_lot::Mutex;

use super::counters::{Count, by_code};

/// The feedback of all names that a node publishes. Its size is bounded by their number, because
/// errors about other names are dropped.
pub struct Feedbacks {
    node: Name,
    names: Mutex<HashMap<Name, Arc<Feedback>>>,
}

impl Feedbacks {
    /// Creates an empty collection. `node` is the source of the frames that errors refer to.
    pub fn new(node: Name) -> Self {
        Self { node, names: Mutex::default() }
    }

    pub fn of(&self, name: Name) -> Arc<Feedback> {
        self.names.lock().entry(name).or_default().clone()
    }

    pub fn forget(&self, name: &Name) {
        self.names.lock().remove(name);
    }

    /// Processes an error that the switch sent.
    pub fn add(&self, code: ErrorCode, error: &Header) {
        if error.source == self.node
            && let Some(feedback) = self.names.lock().get(&error.destination)
        {
            feedback.add(code, error);
        }
    }
}

/// Error reports about frames to one name. They are only hints: they come from the switch, but it
/// rate-limits them, and it reports no losses beyond itself.
#[derive(Default)]
pub struct Feedback {
    errors: [Count; ErrorCode::COUNT],
    last: Mutex<Option<FrameError>>,
}

/// Why the switch did not forward a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", self.reason())]
pub struct FrameError {
    pub code: ErrorCode,
    /// For a frame that was too big: the MTU of the next link, in bytes with the header.
    pub mtu: Option<u32>,
    /// When this node received the error.
    pub at: SystemTime,
}

impl Feedback {
    /// Returns the latest error. It does not apply to frames sent after it.
    pub fn last(&self) -> Option<FrameError> {
        *self.last.lock()
    }

    /// Returns the number of errors by error code. Codes without errors are omitted.
    pub fn errors(&self) -> BTreeMap<&'static str, u64> {
        by_code(&self.errors)
    }

    fn add(&self, code: ErrorCode, error: &Header) {
        self.errors[code.index()].add(1);
        let mtu = (code == ErrorCode::TooBig).then(|| error.complaint().0);
        let last = FrameError { code, mtu, at: SystemTime::now() };
        *self.last.lock() = Some(last);
    }
}

impl FrameError {
    fn reason(&self) -> String {
        match (self.code, self.mtu) {
            (ErrorCode::NoRoute, _) => "nobody takes the name at the moment".into(),
            (ErrorCode::TooBig, Some(mtu)) => format!("a frame is larger than the {mtu} bytes that a link takes"),
            (ErrorCode::TooBig, None) => "a frame is larger than a link takes".into(),
            (ErrorCode::HopLimit, _) => "a frame crossed too many switches; do routes form a loop?".into(),
            (ErrorCode::NotAuthorised, _) => "the switch does not know this node as a writer of the name".into(),
        }
    }
}
