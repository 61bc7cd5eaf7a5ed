//! The calls of a node to its master. <https://wiki.ros.org/ROS/Master_API>

use std::time::Duration;

use super::RpcError;
use super::client::{Callee, call};
use crate::xmlrpc::{Mismatch, Value};

/// The master of a node.
#[derive(Clone, Debug)]
pub struct Master {
    /// The URI, such as `http://localhost:11311/`.
    pub uri: String,
    /// The node's global name.
    pub caller_id: String,
    /// The timeout of each call.
    pub timeout: Duration,
}

/// The reason why a call to the master failed.
#[derive(Debug, thiserror::Error)]
pub enum MasterError {
    #[error("cannot reach the master at {uri}: is roscore running, is ROS_MASTER_URI right? ({source})")]
    Unreachable { uri: String, source: RpcError },
    #[error("the master at {uri} refuses {method}: {text}")]
    Refused { uri: String, method: &'static str, text: String },
}

/// The publishers, subscribers and services: names of topics or services, each with the names of
/// its nodes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SystemState {
    pub publishers: Vec<(String, Vec<String>)>,
    pub subscribers: Vec<(String, Vec<String>)>,
    pub services: Vec<(String, Vec<String>)>,
}

impl Master {
    /// Registers a publisher and returns the slave APIs of the subscribers.
    pub async fn register_publisher(&self, topic: &str, kind: &str, api: &str) -> Result<Vec<String>, MasterError> {
        self.ask("registerPublisher", [topic, kind, api], Value::into_strings).await
    }

    pub async fn unregister_publisher(&self, topic: &str, api: &str) -> Result<(), MasterError> {
        self.ask("unregisterPublisher", [topic, api], ignore).await
    }

    /// Registers a subscriber and returns the slave APIs of the publishers.
    pub async fn register_subscriber(&self, topic: &str, kind: &str, api: &str) -> Result<Vec<String>, MasterError> {
        self.ask("registerSubscriber", [topic, kind, api], Value::into_strings).await
    }

    pub async fn unregister_subscriber(&self, topic: &str, api: &str) -> Result<(), MasterError> {
        self.ask("unregisterSubscriber", [topic, api], ignore).await
    }

    /// Registers a service. `service_api` is `rosrpc://HOST:PORT`.
    pub async fn register_service(&self, service: &str, service_api: &str, api: &str) -> Result<(), MasterError> {
        self.ask("registerService", [service, service_api, api], ignore).await
    }

    pub async fn unregister_service(&self, service: &str, service_api: &str) -> Result<(), MasterError> {
        self.ask("unregisterService", [service, service_api], ignore).await
    }

    /// Returns the URI of a service as `rosrpc://HOST:PORT`. The master refuses the call if no node
    /// serves it.
    pub async fn lookup_service(&self, service: &str) -> Result<String, MasterError> {
        self.ask("lookupService", [service], Value::into_string).await
    }

    /// Returns the slave API of a node. The master refuses the call if it does not know the name.
    pub async fn lookup_node(&self, node: &str) -> Result<String, MasterError> {
        self.ask("lookupNode", [node], Value::into_string).await
    }

    pub async fn system_state(&self) -> Result<SystemState, MasterError> {
        self.ask("getSystemState", [], |value| {
            let [publishers, subscribers, services] = value.into_tuple()?;
            let publishers = by_name(publishers)?;
            Ok(SystemState { publishers, subscribers: by_name(subscribers)?, services: by_name(services)? })
        })
        .await
    }

    /// Returns the topics with their types. The type is `*` if no node has announced one.
    pub async fn topic_types(&self) -> Result<Vec<(String, String)>, MasterError> {
        self.ask("getTopicTypes", [], |value| {
            let pair = |value: Value| {
                let [topic, kind] = value.into_tuple()?;
                Ok((topic.into_string()?, kind.into_string()?))
            };
            value.into_array()?.into_iter().map(pair).collect()
        })
        .await
    }

    async fn ask<const N: usize, T>(
        &self,
        method: &'static str,
        params: [&str; N],
        read: impl FnOnce(Value) -> Result<T, Mismatch>,
    ) -> Result<T, MasterError> {
        let params = std::iter::once(self.caller_id.as_str()).chain(params).map(Value::from);
        let answer = call(Callee::Master, &self.uri, method, params, self.timeout).await;
        answer.and_then(|value| Ok(read(value)?)).map_err(|error| match error {
            RpcError::Refused(text) => MasterError::Refused { uri: self.uri.clone(), method, text },
            source => MasterError::Unreachable { uri: self.uri.clone(), source },
        })
    }
}

/// Ignores the number of removed registrations. It is 0 if the master has restarted.
fn ignore(_: Value) -> Result<(), Mismatch> {
    Ok(())
}

fn by_name(value: Value) -> Result<Vec<(String, Vec<String>)>, Mismatch> {
    let entry = |value: Value| {
        let [name, nodes] = value.into_tuple()?;
        Ok((name.into_string()?, nodes.into_strings()?))
    };
    value.into_array()?.into_iter().map(entry).collect()
}
