//! The stub of a proxy that is built without the relay. It refuses a configuration with a relay.

use std::convert::Infallible;

use crate::config::Config;
use crate::material_error::MaterialError;

/// A relay that cannot exist: [`Relay::load`] never returns one.
pub struct Relay(Infallible);

/// A running relay that cannot exist.
pub struct RunningRelay(Infallible);

impl Relay {
    /// Returns `None` if the configuration has no relay.
    ///
    /// # Errors
    ///
    /// Refuses a configuration with a relay, because this program cannot run one.
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
