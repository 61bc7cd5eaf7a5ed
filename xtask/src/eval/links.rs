//! The links between robot and edge.

use gdp_faults::Faults;
use serde::Serialize;

use crate::bench::paths::Cables;

/// What one of the cables between the hosts is like, in both directions.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum LinkKind {
    /// Nothing is limited
    Plain,
    /// 1 Gb/s, with a queue of 4 ms
    Gigabit,
    /// 300 Mb/s, 3 to 5 ms one way, one of 1000 frames is lost
    Wifi,
}

impl LinkKind {
    pub fn name(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::Gigabit => "1 Gb/s",
            Self::Wifi => "Wi-Fi-like",
        }
    }

    pub fn cables(self) -> Cables {
        match self {
            Self::Plain => Cables::default(),
            Self::Gigabit => {
                Cables::with_faults(Faults { rate: Some(1_000_000_000), queue: Some(500_000), ..Faults::default() })
            }
            Self::Wifi => Cables::with_faults(Faults {
                rate: Some(300_000_000),
                // 20 ms.
                queue: Some(750_000),
                delay: 3_000_000,
                jitter: 2_000_000,
                loss: 0.001,
                ..Faults::default()
            }),
        }
    }
}
