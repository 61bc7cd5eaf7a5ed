//! The values of calls and responses, with accessors.

/// An XML-RPC value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Value {
    Int(i32),
    Bool(bool),
    String(String),
    Array(Vec<Value>),
    /// The members in their order.
    Struct(Vec<(String, Value)>),
}

/// The error for a value that differs from the ROS API.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0} was expected")]
pub struct Mismatch(pub &'static str);

impl Value {
    pub fn array(values: impl IntoIterator<Item = impl Into<Value>>) -> Self {
        Self::Array(values.into_iter().map(Into::into).collect())
    }

    pub fn into_int(self) -> Result<i32, Mismatch> {
        match self {
            Self::Int(int) => Ok(int),
            // Some masters return a boolean where the API specifies 0 or 1.
            Self::Bool(bool) => Ok(bool.into()),
            _ => Err(Mismatch("an integer")),
        }
    }

    pub fn into_string(self) -> Result<String, Mismatch> {
        match self {
            Self::String(string) => Ok(string),
            _ => Err(Mismatch("a string")),
        }
    }

    pub fn into_array(self) -> Result<Vec<Value>, Mismatch> {
        match self {
            Self::Array(values) => Ok(values),
            _ => Err(Mismatch("an array")),
        }
    }

    /// Returns the elements of an array of exactly `N` values.
    pub fn into_tuple<const N: usize>(self) -> Result<[Value; N], Mismatch> {
        self.into_array()?.try_into().map_err(|_| Mismatch("an array of another length"))
    }

    pub fn into_strings(self) -> Result<Vec<String>, Mismatch> {
        self.into_array()?.into_iter().map(Value::into_string).collect()
    }
}

impl From<i32> for Value {
    fn from(int: i32) -> Self {
        Self::Int(int)
    }
}

impl From<bool> for Value {
    fn from(bool: bool) -> Self {
        Self::Bool(bool)
    }
}

impl From<&str> for Value {
    fn from(string: &str) -> Self {
        Self::String(string.to_owned())
    }
}

impl From<String> for Value {
    fn from(string: String) -> Self {
        Self::String(string)
    }
}

impl From<Vec<Value>> for Value {
    fn from(values: Vec<Value>) -> Self {
        Self::Array(values)
    }
}
