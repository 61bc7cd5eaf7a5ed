//! Subscribers of a topic of any type.

use zenoh::Wait;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Locality, Sample, SampleKind};
use zenoh_ext::{AdvancedSubscriber, AdvancedSubscriberBuilderExt, HistoryConfig};

use crate::inbox::Inbox;
use crate::node::{ZenohError, ZenohNode};
use crate::roll::Announced;
use crate::token::Role;
use crate::topic::Topic;

/// A subscriber, which fills an [`Inbox`] until it is dropped. It ignores messages of its own
/// session.
pub struct RawSubscriber {
    _source: Source,
    _announced: Announced,
}

enum Source {
    Plain {
        _subscriber: Subscriber<()>,
    },
    /// Requests the history of transient-local publishers.
    Advanced {
        _subscriber: AdvancedSubscriber<()>,
    },
}

impl RawSubscriber {
    pub fn new(of: &ZenohNode, topic: &Topic, inbox: &Inbox) -> Result<Self, ZenohError> {
        let roll = of.roll()?;
        let announced = roll.announce(Role::Subscriber, topic, "")?;
        let slot = inbox.slot();
        let received = move |sample: Sample| {
            if sample.kind() == SampleKind::Put {
                slot.put(&sample);
            }
        };
        let subscriber = roll.session().declare_subscriber(topic.key(roll.domain())).callback(received);
        let subscriber = subscriber.allowed_origin(Locality::Remote);
        let source = match topic.qos.transient_local {
            false => Source::Plain { _subscriber: subscriber.wait()? },
            true => {
                let depth = topic.qos.depth.map_or(usize::MAX, |depth| depth.max(1) as usize);
                // Without recovery, so that gaps leave nothing in memory.
                let history = HistoryConfig::default().max_samples(depth).detect_late_publishers();
                Source::Advanced { _subscriber: subscriber.history(history).subscriber_detection().wait()? }
            }
        };
        Ok(Self { _source: source, _announced: announced })
    }
}
