//! Times and encodings, as Python writes them.

use std::time::Duration;

use gdp::Encoding;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Returns a span of time. Python has seconds in floating point.
pub fn seconds(seconds: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(seconds).map_err(|error| PyValueError::new_err(format!("{seconds} s: {error}")))
}

/// Parses the name of an encoding.
pub fn parse_encoding(text: &str) -> PyResult<Encoding> {
    match text {
        "bytes" => Ok(Encoding::Bytes),
        "json" => Ok(Encoding::Json),
        "cdr" => Ok(Encoding::Cdr),
        "ros1" => Ok(Encoding::Ros1),
        other => other
            .parse()
            .map(Encoding::Other)
            .map_err(|_| PyValueError::new_err(format!("{other:?} is not bytes, json, cdr, ros1 or a number"))),
    }
}

/// Returns the name of an encoding.
pub fn encoding_name(encoding: Encoding) -> String {
    match encoding {
        Encoding::Bytes => "bytes".into(),
        Encoding::Json => "json".into(),
        Encoding::Cdr => "cdr".into(),
        Encoding::Ros1 => "ros1".into(),
        other => u16::from(other).to_string(),
    }
}
