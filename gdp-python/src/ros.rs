//! Publishers and subscribers of ROS messages, whose values are JSON texts here.

use std::sync::Arc;
use std::time::UNIX_EPOCH;

use crate::runtime::awaitable;
use gdp_ros::sdk::{DynamicPublisher, DynamicSubscriber};
use pyo3::prelude::*;
use tokio::sync::Mutex;

use crate::convert::seconds;
use crate::errors::{raised, ros_raised};

/// Publishes ROS messages.
#[pyclass(frozen, name = "RosPublisher", module = "gdp._gdp")]
pub struct NativeRosPublisher(pub DynamicPublisher);

#[pymethods]
impl NativeRosPublisher {
    /// Sends a message that is written in YAML or JSON.
    fn put_text<'py>(&self, py: Python<'py>, values: String) -> PyResult<Bound<'py, PyAny>> {
        let publisher = self.0.clone();
        awaitable(py, async move { publisher.put_text(&values).await.map_err(ros_raised) })
    }

    fn flush<'py>(&self, py: Python<'py>, timeout: f64) -> PyResult<Bound<'py, PyAny>> {
        let (publisher, timeout) = (self.0.publisher().clone(), seconds(timeout)?);
        awaitable(py, async move { publisher.flush(timeout).await.map_err(raised) })
    }

    fn wait_for_readers<'py>(&self, py: Python<'py>, readers: usize) -> PyResult<Bound<'py, PyAny>> {
        let publisher = self.0.publisher().clone();
        awaitable(py, async move { publisher.wait_for_readers(readers).await.map_err(raised) })
    }

    #[getter]
    fn readers(&self) -> usize {
        self.0.publisher().readers()
    }

    #[getter]
    fn name(&self) -> String {
        self.0.publisher().name().to_string()
    }
}

/// Reads ROS messages of any type.
#[pyclass(frozen, name = "RosSubscriber", module = "gdp._gdp")]
pub struct NativeRosSubscriber(pub Arc<Mutex<DynamicSubscriber>>);

#[pymethods]
impl NativeRosSubscriber {
    /// Returns type, JSON text, source and time of the next message, or nothing at the end.
    fn recv<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let subscriber = self.0.clone();
        awaitable(py, async move {
            let received = subscriber.lock().await.recv().await.map_err(ros_raised)?;
            Ok(received.map(|message| {
                let time = message.time.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
                (message.type_name, message.value.to_string(), message.source.to_string(), time)
            }))
        })
    }
}
