//! The exceptions of the package.

use gdp::Error;
use gdp_ros::sdk::RosSdkError;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;

pyo3::create_exception!(gdp, GdpError, PyException, "Anything that the Global Data Plane refuses.");
pyo3::create_exception!(gdp, ConfigError, GdpError, "The keyring, the key or the switch's address is wrong.");
pyo3::create_exception!(gdp, NotFoundError, GdpError, "There is no such topic or service.");
pyo3::create_exception!(gdp, RightsError, GdpError, "A certificate is missing, has expired or was revoked.");
pyo3::create_exception!(gdp, LinkError, GdpError, "There is no link to the switch, or the fabric refuses.");
pyo3::create_exception!(gdp, NoReplyError, GdpError, "Nobody answered in time.");
pyo3::create_exception!(gdp, MessageError, GdpError, "A ROS message does not fit its type.");

pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("GdpError", py.get_type::<GdpError>())?;
    module.add("ConfigError", py.get_type::<ConfigError>())?;
    module.add("NotFoundError", py.get_type::<NotFoundError>())?;
    module.add("RightsError", py.get_type::<RightsError>())?;
    module.add("LinkError", py.get_type::<LinkError>())?;
    module.add("NoReplyError", py.get_type::<NoReplyError>())?;
    module.add("MessageError", py.get_type::<MessageError>())
}

/// Returns the exception for an error of a session.
pub fn raised(error: Error) -> PyErr {
    let text = error.to_string();
    match error {
        Error::Switch(_) | Error::Keyring(_) | Error::Key { .. } | Error::Credentials(_) => ConfigError::new_err(text),
        Error::Find(_) | Error::Members(_) => NotFoundError::new_err(text),
        Error::Right(_) | Error::Ended(_) => RightsError::new_err(text),
        Error::NoReply { .. } | Error::NoServer { .. } | Error::Unflushed { .. } => NoReplyError::new_err(text),
        Error::Fabric(_) => LinkError::new_err(text),
        _ => GdpError::new_err(text),
    }
}

/// Returns the exception for an error with ROS messages.
pub fn ros_raised(error: RosSdkError) -> PyErr {
    match error {
        RosSdkError::Session(error) => raised(error),
        other => MessageError::new_err(other.to_string()),
    }
}
