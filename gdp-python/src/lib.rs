//! The extension module `gdp._gdp`: sessions of the crate `gdp` for Python.
//!
//! Each method that waits returns an awaitable of asyncio. The package in `python/gdp` adds what
//! Python does better: context managers, iterators, dictionaries, and the blocking form.
// `print!` and `eprint!` panic when stdout or stderr cannot be written.
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod calls;
mod convert;
mod errors;
mod receiving;
mod ros;
mod runtime;
mod session;
mod topics;
mod values;

use pyo3::prelude::*;

/// The native part of the package `gdp`.
#[pymodule]
fn _gdp(module: &Bound<'_, PyModule>) -> PyResult<()> {
    errors::add(module)?;
    module.add_function(wrap_pyfunction!(session::open, module)?)?;
    module.add_function(wrap_pyfunction!(runtime::finish, module)?)?;
    module.add_class::<session::NativeSession>()?;
    module.add_class::<topics::NativePublisher>()?;
    module.add_class::<topics::NativeSubscriber>()?;
    module.add_class::<topics::NativeSample>()?;
    module.add_class::<calls::NativeClient>()?;
    module.add_class::<calls::NativeServer>()?;
    module.add_class::<calls::NativeCall>()?;
    module.add_class::<ros::NativeRosPublisher>()?;
    module.add_class::<ros::NativeRosSubscriber>()?;
    Ok(())
}
