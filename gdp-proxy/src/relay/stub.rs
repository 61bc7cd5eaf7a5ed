//! The stub of a proxy that is built without the relay: it refuses a configuration with one.

use std::convert::Infallible;

use crate::config::Config;
use crate::material_error::MaterialError;

/// A relay that cannot be: [`Relay::load`] never returns one.
pub struct Relay(Infallible);

/// As [`Relay`].
pub struct RunningRelay(Infallible);

impl Relay {
    /// Nothing, where the configuration has no relay.
    ///
    /// # Errors
    ///
    /// A configuration with a relay is refused, because this program cannot run one.
    pub fn load(config: &Config) -> Result<Option<Self>, MaterialError> {
        match config.relay {
            None => Ok(None),
            Some(_) => Err(MaterialError {
                key: "relay".into(),
                reason: "this gdp-proxy was built without relays; build it with `--features relay`, or remove the key"
                    .into(),
            }),
        }
    }

    pub async fn start(self) -> Result<RunningRelay, Infallible> {
        match self.0 {}
    }
}

impl RunningRelay {
    pub async fn stop(self) {
        match self.0 {}
    }
}
