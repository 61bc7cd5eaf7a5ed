//! Publishers and subscribers of bytes.

use std::time::UNIX_EPOCH;

use crate::runtime::awaitable;
use gdp::{Publisher, Sample, Subscriber};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::pybacked::{PyBackedBytes, PyBackedStr};
use pyo3::types::{PyBytes, PyString};

use crate::convert::{encoding_name, seconds};
use crate::errors::raised;
use crate::receiving::{Receive, Receiving};

/// The content of a message: bytes, or a text that is sent as UTF-8.
pub enum Payload {
    /// `bytes` or `bytearray`.
    Bytes(PyBackedBytes),
    /// `str`.
    Text(PyBackedStr),
}

impl<'a, 'py> FromPyObject<'a, 'py> for Payload {
    type Error = PyErr;

    fn extract(given: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        if let Ok(bytes) = given.extract() {
            return Ok(Self::Bytes(bytes));
        }
        if given.is_instance_of::<PyString>() {
            return given.extract().map(Self::Text);
        }
        let got = given.get_type().name()?;
        Err(PyTypeError::new_err(format!("a payload is bytes, bytearray or str, and not {got}")))
    }
}

impl AsRef<[u8]> for Payload {
    fn as_ref(&self) -> &[u8] {
        match self {
            Self::Bytes(bytes) => bytes,
            Self::Text(text) => text.as_bytes(),
        }
    }
}

/// Publishes a topic.
#[pyclass(frozen, name = "Publisher", module = "gdp._gdp")]
pub struct NativePublisher(pub Publisher);

#[pymethods]
impl NativePublisher {
    fn put<'py>(&self, py: Python<'py>, payload: Payload) -> PyResult<Bound<'py, PyAny>> {
        let publisher = self.0.clone();
        awaitable(py, async move { publisher.put(payload).await.map_err(raised) })
    }

    fn flush<'py>(&self, py: Python<'py>, timeout: f64) -> PyResult<Bound<'py, PyAny>> {
        let (publisher, timeout) = (self.0.clone(), seconds(timeout)?);
        awaitable(py, async move { publisher.flush(timeout).await.map_err(raised) })
    }

    fn wait_for_readers<'py>(&self, py: Python<'py>, readers: usize) -> PyResult<Bound<'py, PyAny>> {
        let publisher = self.0.clone();
        awaitable(py, async move { publisher.wait_for_readers(readers).await.map_err(raised) })
    }

    #[getter]
    fn readers(&self) -> usize {
        self.0.readers()
    }

    #[getter]
    fn name(&self) -> String {
        self.0.name().to_string()
    }

    fn __repr__(&self) -> String {
        format!("{:?}", self.0)
    }
}

/// Reads a topic.
#[pyclass(frozen, name = "Subscriber", module = "gdp._gdp")]
pub struct NativeSubscriber {
    name: String,
    subscriber: Receiving<Subscriber>,
}

impl Receive for Subscriber {
    type Received = NativeSample;

    async fn receive(&mut self) -> PyResult<Option<NativeSample>> {
        Ok(self.recv().await.map_err(raised)?.map(NativeSample))
    }
}

impl NativeSubscriber {
    pub fn new(subscriber: Subscriber) -> Self {
        Self { name: subscriber.name().to_string(), subscriber: Receiving::new(subscriber) }
    }
}

#[pymethods]
impl NativeSubscriber {
    #[pyo3(signature = (timeout=None))]
    fn ready<'py>(&self, py: Python<'py>, timeout: Option<f64>) -> PyResult<Bound<'py, PyAny>> {
        self.subscriber.ready(py, timeout)
    }

    fn take(&self) -> PyResult<Vec<Option<NativeSample>>> {
        self.subscriber.take()
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
    }
}

/// A received message.
#[pyclass(frozen, name = "Sample", module = "gdp._gdp")]
pub struct NativeSample(pub Sample);

#[pymethods]
impl NativeSample {
    #[getter]
    fn payload<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, self.0.payload())
    }

    #[getter]
    fn topic(&self) -> &str {
        self.0.topic()
    }

    #[getter]
    fn source(&self) -> String {
        self.0.source().to_string()
    }

    #[getter]
    fn sequence(&self) -> u64 {
        self.0.sequence()
    }

    #[getter]
    fn time(&self) -> f64 {
        self.0.time().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64()
    }

    #[getter]
    fn encoding(&self) -> String {
        encoding_name(self.0.encoding())
    }

    #[getter]
    fn latched(&self) -> bool {
        self.0.is_latched()
    }

    fn text(&self) -> PyResult<&str> {
        self.0.text().map_err(|error| PyValueError::new_err(error.to_string()))
    }

    fn __repr__(&self) -> String {
        let bytes = self.0.payload().len();
        format!("Sample(topic={:?}, sequence={}, bytes={bytes})", self.0.topic(), self.0.sequence())
    }
}
