//! Clients and servers.

use crate::runtime::awaitable;
use gdp::{Client, IncomingCall, Server};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::errors::raised;
use crate::receiving::{Receive, Receiving};
use crate::topics::{NativeSample, Payload};

/// Calls a service.
#[pyclass(frozen, name = "Client", module = "gdp._gdp")]
pub struct NativeClient(pub Client);

#[pymethods]
impl NativeClient {
    fn call<'py>(&self, py: Python<'py>, request: Payload) -> PyResult<Bound<'py, PyAny>> {
        let client = self.0.clone();
        awaitable(py, async move { Ok(NativeSample(client.call(request).await.map_err(raised)?)) })
    }

    #[getter]
    fn servers(&self) -> usize {
        self.0.servers()
    }

    #[getter]
    fn name(&self) -> String {
        self.0.name().to_string()
    }
}

/// Receives the calls to a service.
#[pyclass(frozen, name = "Server", module = "gdp._gdp")]
pub struct NativeServer {
    name: String,
    server: Receiving<Server>,
}

impl Receive for Server {
    type Received = NativeCall;

    async fn receive(&mut self) -> PyResult<Option<NativeCall>> {
        let call = self.recv().await.map_err(raised)?;
        Ok(call.map(|call| NativeCall(std::sync::Mutex::new(Some(call)))))
    }
}

impl NativeServer {
    pub fn new(server: Server) -> Self {
        Self { name: server.name().to_string(), server: Receiving::new(server) }
    }
}

#[pymethods]
impl NativeServer {
    #[pyo3(signature = (timeout=None))]
    fn ready<'py>(&self, py: Python<'py>, timeout: Option<f64>) -> PyResult<Bound<'py, PyAny>> {
        self.server.ready(py, timeout)
    }

    fn take(&self) -> PyResult<Vec<Option<NativeCall>>> {
        self.server.take()
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
    }
}

/// A call that waits for its reply, until that is sent.
#[pyclass(frozen, name = "Call", module = "gdp._gdp")]
pub struct NativeCall(std::sync::Mutex<Option<IncomingCall>>);

impl NativeCall {
    fn with<T>(&self, what: impl FnOnce(&mut Option<IncomingCall>) -> Option<T>) -> PyResult<T> {
        let mut call = self.0.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        what(&mut call).ok_or_else(|| PyRuntimeError::new_err("the call was answered"))
    }
}

#[pymethods]
impl NativeCall {
    #[getter]
    fn payload<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.with(|call| call.as_ref().map(|call| PyBytes::new(py, call.payload())))
    }

    #[getter]
    fn source(&self) -> PyResult<String> {
        self.with(|call| call.as_ref().map(|call| call.source().to_string()))
    }

    fn reply<'py>(&self, py: Python<'py>, payload: Payload) -> PyResult<Bound<'py, PyAny>> {
        let call = self.with(Option::take)?;
        awaitable(py, async move { call.reply(payload).await.map_err(raised) })
    }
}
