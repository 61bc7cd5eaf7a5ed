//! Publishers and subscribers of ROS messages. Those to send are JSON texts here.

use std::time::UNIX_EPOCH;

use crate::runtime::awaitable;
use gdp_ros::sdk::{DynamicMessage, DynamicPublisher, DynamicSubscriber};
use pyo3::prelude::*;

use crate::convert::seconds;
use crate::errors::{raised, ros_raised};
use crate::receiving::{Receive, Receiving};
use crate::values;

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
pub struct NativeRosSubscriber(pub Receiving<DynamicSubscriber>);

/// Type, fields, source and time of a message.
type RosMessage<'py> = (String, Bound<'py, PyAny>, String, f64);

impl Receive for DynamicSubscriber {
    type Received = DynamicMessage;

    async fn receive(&mut self) -> PyResult<Option<DynamicMessage>> {
        self.recv().await.map_err(ros_raised)
    }
}

#[pymethods]
impl NativeRosSubscriber {
    #[pyo3(signature = (timeout=None))]
    fn ready<'py>(&self, py: Python<'py>, timeout: Option<f64>) -> PyResult<Bound<'py, PyAny>> {
        self.0.ready(py, timeout)
    }

    fn take<'py>(&self, py: Python<'py>) -> PyResult<Vec<Option<RosMessage<'py>>>> {
        let object = |message: DynamicMessage| {
            let value = values::message(py, &message.schema, &message.value)?;
            let time = message.time.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
            Ok((message.type_name, value, message.source.to_string(), time))
        };
        self.0.take()?.into_iter().map(|message| message.map(object).transpose()).collect()
    }
}
