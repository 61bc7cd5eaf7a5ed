//! The feedback of the receiving thread to writers: all that is due for one entity at a time
//! travels in one frame.

use std::collections::BTreeMap;

use gdp_e2e::feedback_wire::{Feedback, MAX_FEEDBACK};
use gdp_wire::Name;

/// Messages by the entity that receives them. Each subscription adds a few, and they are sent
/// before the thread sleeps.
#[derive(Default)]
pub struct OutgoingFeedback(BTreeMap<Name, Vec<Feedback>>);

impl OutgoingFeedback {
    pub fn push(&mut self, writer: &Name, feedback: Feedback) {
        self.0.entry(*writer).or_default().push(feedback);
    }

    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns whether a frame to this entity will be sent anyway.
    pub fn has(&self, writer: &Name) -> bool {
        self.0.contains_key(writer)
    }

    /// Passes all messages to `send`, as many in one call as fit a frame.
    pub fn flush(&mut self, mut send: impl FnMut(&Name, &[Feedback])) {
        for (writer, mut feedback) in std::mem::take(&mut self.0) {
            feedback.extract_if(.., |message| message.travels_alone()).for_each(|message| send(&writer, &[message]));
            if feedback.is_empty() {
                continue;
            }
            let (mut begin, mut bytes) = (0, 0);
            for (index, message) in feedback.iter().enumerate() {
                let length = message.encoded_len();
                if bytes + length > MAX_FEEDBACK {
                    send(&writer, &feedback[begin..index]);
                    (begin, bytes) = (index, 0);
                }
                bytes += length;
            }
            send(&writer, &feedback[begin..]);
        }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/node/outgoing_feedback.rs"]
mod tests;
