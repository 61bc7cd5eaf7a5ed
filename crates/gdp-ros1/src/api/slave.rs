//! The slave API without I/O: the calls that masters, other nodes and tools make to a node.
//! <https://wiki.ros.org/ROS/Slave_API>

use super::RpcError;
use super::client::{Callee, call};
use crate::xmlrpc::{Call, Fault, Mismatch, Value};
use std::time::Duration;

/// A call of the slave API.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SlaveCall {
    BusStats,
    BusInfo,
    MasterUri,
    /// A request to shut down this node.
    Shutdown {
        caller: String,
        reason: String,
    },
    Pid,
    Subscriptions,
    Publications,
    /// A changed parameter. This node subscribes to none.
    ParamUpdate,
    /// The slave APIs of all current publishers of a topic.
    PublisherUpdate {
        topic: String,
        publishers: Vec<String>,
    },
    /// A subscriber's request for the address of a topic, with its protocols by preference.
    RequestTopic {
        caller: String,
        topic: String,
        protocols: Vec<String>,
    },
}

/// The reason why a call is refused.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The method does not exist.
    Unknown(Fault),
    /// The parameters do not fit the method. The response has the API's form of an error.
    Params(String),
}

impl TryFrom<Call> for SlaveCall {
    type Error = Refusal;

    fn try_from(Call { method, params }: Call) -> Result<Self, Refusal> {
        let bad = |reason: Mismatch| Refusal::Params(format!("{method}: {reason}"));
        let params = Value::Array(params);
        let read = || -> Result<Option<Self>, Mismatch> {
            Ok(Some(match method.as_str() {
                "getBusStats" => Self::BusStats,
                "getBusInfo" => Self::BusInfo,
                "getMasterUri" => Self::MasterUri,
                "getPid" => Self::Pid,
                "getSubscriptions" => Self::Subscriptions,
                "getPublications" => Self::Publications,
                "paramUpdate" => Self::ParamUpdate,
                "shutdown" => {
                    // The reason is optional.
                    let mut texts = params.into_strings()?.into_iter();
                    let caller = texts.next().ok_or(Mismatch("a caller id"))?;
                    Self::Shutdown { caller, reason: texts.next().unwrap_or_default() }
                }
                "publisherUpdate" => {
                    let [_, topic, publishers] = params.into_tuple()?;
                    Self::PublisherUpdate { topic: topic.into_string()?, publishers: publishers.into_strings()? }
                }
                "requestTopic" => {
                    let [caller, topic, protocols] = params.into_tuple()?;
                    let name = |protocol: Value| {
                        protocol.into_array()?.into_iter().next().ok_or(Mismatch("a protocol's name"))?.into_string()
                    };
                    let protocols = protocols.into_array()?.into_iter().map(name).collect::<Result<_, _>>()?;
                    Self::RequestTopic { caller: caller.into_string()?, topic: topic.into_string()?, protocols }
                }
                _ => return Ok(None),
            }))
        };
        let known = read().map_err(bad)?;
        known.ok_or_else(|| Refusal::Unknown(Fault { code: 1, text: format!("there is no method {method:?}") }))
    }
}

/// Returns the response to a successful call.
pub fn success(text: &str, value: impl Into<Value>) -> Value {
    Value::Array(vec![Value::Int(1), text.into(), value.into()])
}

/// Returns the response to a failed call. Code 0 means that the node failed, and -1 that the caller
/// made an error.
pub fn failure(code: i32, text: &str) -> Value {
    Value::Array(vec![Value::Int(code), text.into(), Value::Int(0)])
}

/// Requests a topic's TCPROS address from a publisher. Returns host and port.
pub async fn request_topic(
    publisher: &str,
    caller_id: &str,
    topic: &str,
    limit: Duration,
) -> Result<(String, u16), RpcError> {
    let protocols = Value::Array(vec![Value::array(["TCPROS"])]);
    let answer =
        call(Callee::Node, publisher, "requestTopic", [caller_id.into(), topic.into(), protocols], limit).await?;
    let mut params = answer.into_array()?.into_iter();
    let (Some(protocol), Some(host), Some(port)) = (params.next(), params.next(), params.next()) else {
        return Err(Mismatch("a protocol, a host and a port").into());
    };
    if protocol.into_string()? != "TCPROS" {
        return Err(Mismatch("the protocol TCPROS").into());
    }
    let port = u16::try_from(port.into_int()?).map_err(|_| Mismatch("a port"))?;
    Ok((host.into_string()?, port))
}

#[cfg(test)]
#[path = "../../tests/unit/api/slave.rs"]
mod tests;
