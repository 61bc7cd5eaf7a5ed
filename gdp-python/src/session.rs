//! Sessions.

use std::path::PathBuf;

use crate::runtime::awaitable;
use gdp::{Config, Keyring, LinkTargetError, Session};
use gdp_ros::sdk::RosSession as _;
use pyo3::prelude::*;

use crate::calls::{NativeClient, NativeServer};
use crate::convert::{parse_encoding, seconds};
use crate::errors::{ConfigError, raised, ros_raised};
use crate::receiving::Receiving;
use crate::ros::{NativeRosPublisher, NativeRosSubscriber};
use crate::topics::{NativePublisher, NativeSubscriber};

/// Attaches to a switch. The package looks at the environment: `switch_of` says where `switch` is
/// from.
#[pyfunction]
#[pyo3(signature = (keyring, switch, switch_of, key, timeout))]
pub fn open(
    py: Python<'_>,
    keyring: Option<PathBuf>,
    switch: Option<String>,
    switch_of: String,
    key: Option<PathBuf>,
    timeout: f64,
) -> PyResult<Bound<'_, PyAny>> {
    let timeout = seconds(timeout)?;
    awaitable(py, async move {
        let keyring = keyring.map_or_else(Keyring::default_folder, Ok).map_err(|error| raised(error.into()))?;
        let mut config = Config::new(keyring);
        if let Some(switch) = switch {
            let target = switch.parse();
            let target =
                target.map_err(|error: LinkTargetError| ConfigError::new_err(format!("{switch_of}: {error}")))?;
            config = config.switch(target);
        }
        if let Some(key) = key {
            config = config.key(key);
        }
        let session = gdp::open(config.timeout(timeout)).await.map_err(raised)?;
        Ok(NativeSession(session))
    })
}

/// An entity that is attached to a switch.
#[pyclass(frozen, name = "Session", module = "gdp._gdp")]
pub struct NativeSession(Session);

#[pymethods]
impl NativeSession {
    #[getter]
    fn name(&self) -> String {
        self.0.name().to_string()
    }

    #[pyo3(signature = (topic, reliable, latched, encoding))]
    fn publisher<'py>(
        &self,
        py: Python<'py>,
        topic: String,
        reliable: bool,
        latched: usize,
        encoding: &str,
    ) -> PyResult<Bound<'py, PyAny>> {
        let builder = self.0.publisher(topic).latched(latched).encoding(parse_encoding(encoding)?);
        let builder = if reliable { builder.reliable() } else { builder };
        awaitable(py, async move { Ok(NativePublisher(builder.await.map_err(raised)?)) })
    }

    fn subscriber<'py>(&self, py: Python<'py>, topic: String, newest: bool) -> PyResult<Bound<'py, PyAny>> {
        let builder = self.0.subscriber(topic);
        let builder = if newest { builder.newest() } else { builder };
        awaitable(py, async move { Ok(NativeSubscriber::new(builder.await.map_err(raised)?)) })
    }

    fn client<'py>(&self, py: Python<'py>, service: String, timeout: f64) -> PyResult<Bound<'py, PyAny>> {
        let builder = self.0.client(service).timeout(seconds(timeout)?);
        awaitable(py, async move { Ok(NativeClient(builder.await.map_err(raised)?)) })
    }

    fn server<'py>(&self, py: Python<'py>, service: String) -> PyResult<Bound<'py, PyAny>> {
        let builder = self.0.server(service);
        awaitable(py, async move { Ok(NativeServer::new(builder.await.map_err(raised)?)) })
    }

    #[pyo3(signature = (topic, type_name, reliable, transient_local, depth, definitions))]
    #[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
    fn ros_publisher<'py>(
        &self,
        py: Python<'py>,
        topic: String,
        type_name: String,
        reliable: bool,
        transient_local: bool,
        depth: u32,
        definitions: Vec<PathBuf>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let ros = definitions.into_iter().fold(self.0.ros(), |ros, folder| ros.definitions(folder));
        let builder = ros.dynamic_publisher(topic, type_name).depth(depth);
        let builder = if reliable { builder } else { builder.best_effort() };
        let builder = if transient_local { builder.transient_local() } else { builder };
        awaitable(py, async move { Ok(NativeRosPublisher(builder.await.map_err(ros_raised)?)) })
    }

    fn ros_subscriber<'py>(
        &self,
        py: Python<'py>,
        topic: String,
        definitions: Vec<PathBuf>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let ros = definitions.into_iter().fold(self.0.ros(), |ros, folder| ros.definitions(folder));
        awaitable(py, async move {
            let subscriber = ros.dynamic_subscriber(topic).await.map_err(ros_raised)?;
            Ok(NativeRosSubscriber(Receiving::new(subscriber)))
        })
    }

    fn close<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let session = self.0.clone();
        awaitable(py, async move { session.close().await.map_err(raised) })
    }

    fn __repr__(&self) -> String {
        format!("{:?}", self.0)
    }
}
