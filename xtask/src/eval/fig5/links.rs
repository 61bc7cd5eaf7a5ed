//! The links between the hosts: their rate, delay and loss, by `gdp_faults`.

use gdp_faults::{Faults, MILLISECOND};

use crate::bench::paths::Cables;

/// The kind of the cable before the cloud. The other cables are always plain.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LinkShape {
    /// As fast as the machine
    Plain,
    /// 1 Gb/s, with a queue of 4 ms
    Gigabit,
    /// 300 Mb/s with a queue of 20 ms, 3 to 5 ms of delay, and 0.1 % of the frames lost
    Wifi,
}

impl LinkShape {
    /// Returns the name of the figure.
    pub fn figure(self) -> &'static str {
        match self {
            Self::Plain => "eval-fig5",
            Self::Gigabit => "eval-fig5-gigabit",
            Self::Wifi => "eval-fig5-wifi",
        }
    }

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
                Cables::with_faults(Faults { rate: Some(1_000_000_000), queue: Some(500_000), ..Default::default() })
            }
            Self::Wifi => Cables::with_faults(Faults {
                rate: Some(300_000_000),
                queue: Some(750_000),
                delay: 3 * MILLISECOND,
                jitter: 2 * MILLISECOND,
                loss: 0.001,
                ..Default::default()
            }),
        }
    }
}
