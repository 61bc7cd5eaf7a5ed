//! Values of ROS messages as Python's objects, by their definitions.

use base64ct::{Base64, Encoding as _};
use gdp_msg::{Base, Count, Scalar, Schema};
use gdp_ros::fill::{definition, is_octet};
use pyo3::IntoPyObjectExt as _;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};
use serde_json::Value;

/// Returns a message as a dictionary. Arrays of bytes are `bytes`, and floating-point fields are
/// always `float`.
pub fn message<'py>(py: Python<'py>, schema: &Schema, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    one(py, schema, &Base::Named(schema.name().clone()), value)
}

fn field<'py>(
    py: Python<'py>,
    schema: &Schema,
    (base, count): (&Base, Count),
    value: &Value,
) -> PyResult<Bound<'py, PyAny>> {
    match (base, value) {
        (_, value) if count == Count::One => one(py, schema, base, value),
        (_, Value::Array(items)) => {
            let items = items.iter().map(|item| one(py, schema, base, item)).collect::<PyResult<Vec<_>>>()?;
            PyList::new(py, items)?.into_bound_py_any(py)
        }
        (Base::Scalar(scalar), Value::String(base64)) if is_octet(*scalar) => match Base64::decode_vec(base64) {
            Ok(octets) => PyBytes::new(py, &octets).into_bound_py_any(py),
            Err(_) => base64.into_bound_py_any(py),
        },
        (base, value) => one(py, schema, base, value),
    }
}

fn one<'py>(py: Python<'py>, schema: &Schema, base: &Base, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    match (base, value) {
        (Base::Named(name), Value::Object(members)) => {
            let fields = definition(schema, name).map_or(&[][..], |definition| &definition.fields);
            let object = PyDict::new(py);
            for (name, value) in members {
                let value = match fields.iter().find(|field| *field.name == **name) {
                    Some(of) => field(py, schema, (&of.base, of.count), value)?,
                    None => plain(py, value)?,
                };
                object.set_item(name, value)?;
            }
            object.into_bound_py_any(py)
        }
        (Base::Scalar(scalar), value) => number(py, *scalar, value),
        (_, value) => plain(py, value),
    }
}

/// JSON has large integers, NaN and infinities as text.
fn number<'py>(py: Python<'py>, scalar: Scalar, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    let is_float = matches!(scalar, Scalar::Float32 | Scalar::Float64);
    let number = match value {
        Value::String(text) if is_float => text.parse::<f64>().ok(),
        value if is_float => value.as_f64(),
        _ => None,
    };
    match (number, value) {
        (Some(number), _) => number.into_bound_py_any(py),
        (None, Value::String(text)) => match text.parse::<i128>() {
            Ok(number) => number.into_bound_py_any(py),
            Err(_) => text.into_bound_py_any(py),
        },
        (None, value) => plain(py, value),
    }
}

/// Converts what has no definition, such as a time of ROS 1.
fn plain<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    match value {
        Value::Null => Ok(py.None().into_bound(py)),
        Value::Bool(value) => value.into_bound_py_any(py),
        Value::Number(number) => match (number.as_i64(), number.as_u64()) {
            (Some(number), _) => number.into_bound_py_any(py),
            (None, Some(number)) => number.into_bound_py_any(py),
            (None, None) => number.as_f64().unwrap_or(f64::NAN).into_bound_py_any(py),
        },
        Value::String(text) => text.into_bound_py_any(py),
        Value::Array(items) => {
            let items = items.iter().map(|item| plain(py, item)).collect::<PyResult<Vec<_>>>()?;
            PyList::new(py, items)?.into_bound_py_any(py)
        }
        Value::Object(members) => {
            let object = PyDict::new(py);
            for (name, value) in members {
                object.set_item(name, plain(py, value)?)?;
            }
            object.into_bound_py_any(py)
        }
    }
}
