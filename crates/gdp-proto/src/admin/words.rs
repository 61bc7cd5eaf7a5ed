//! Closed sets of words in replies.

use gdp_core::domain::Relationship;

/// An enum whose variants are these words, in JSON and for people.
macro_rules! words {
    ($(#[$doc:meta])* $name:ident { $($(#[$of:meta])* $variant:ident = $word:literal,)+ }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
        pub enum $name {
            $($(#[$of])* #[serde(rename = $word)] $variant,)+
        }

        impl $name {
            pub fn as_str(self) -> &'static str {
                match self {
                    $(Self::$variant => $word,)+
                }
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.pad(self.as_str())
            }
        }
    };
}

words! {
    /// What the switch refused.
    RefusedThing {
        Link = "link",
        /// An attachment or registration of an endpoint.
        Registration = "registration",
    }
}

words! {
    /// What the peer of a link is to the data planes.
    PeerRole {
        Endpoint = "endpoint",
        Switch = "switch",
        /// A switch of another domain.
        Border = "border",
    }
}

words! {
    /// What the peer of a link is to this switch's domain.
    PeerRelationship {
        /// One of them, or both, show no membership.
        Stranger = "stranger",
        /// Of the same domain.
        Member = "member",
        /// A border switch of a peered domain.
        Border = "border",
        /// An endpoint of a peered domain, attached here.
        Visitor = "visitor",
        /// A switch of a peered domain that this endpoint is attached to.
        Host = "host",
    }
}

words! {
    /// What became of the link to a peer.
    PeerLink {
        Up = "up",
        /// The peer is silent, and its data plane may still forward.
        Grace = "grace",
        Down = "down",
    }
}

words! {
    /// Where a neighbouring domain is in the tree of domains.
    TierKind {
        Parent = "parent",
        Child = "child",
    }
}

words! {
    /// The session of this RIB with that of a neighbouring domain.
    TierState {
        Waiting = "waiting",
        Up = "up",
        Lost = "lost",
        Refused = "refused",
    }
}

words! {
    /// What became of a trace in a domain.
    Outcome {
        Traced = "traced",
        /// Nobody has answered in time.
        Unanswered = "unanswered",
        /// The domain refused, for a reason.
        Refused = "refused",
        /// The frames have crossed the domain before.
        Loop = "loop",
        /// The frames have crossed too many domains before it.
        TooFar = "too_far",
    }
}

impl From<&Relationship> for PeerRelationship {
    fn from(relationship: &Relationship) -> Self {
        match relationship {
            Relationship::Stranger => Self::Stranger,
            Relationship::Member { .. } => Self::Member,
            Relationship::Border { .. } => Self::Border,
            Relationship::Visitor { .. } => Self::Visitor,
            Relationship::Host { .. } => Self::Host,
        }
    }
}

words! {
    /// Which way a proxy carries a topic, seen from its ROS graph.
    TopicDirection {
        /// From the graph into the fabric.
        Out = "out",
        In = "in",
    }
}

words! {
    /// The state of an endpoint's link.
    FabricLinkState {
        Up = "up",
        /// The link is up, but the switch has not answered the latest echoes.
        Silent = "silent",
        /// The switch became silent; its data plane may continue to forward.
        Stale = "stale",
        Down = "down",
    }
}
