//! The calls of a node to its master. <https://wiki.ros.org/ROS/Master_API>

use std::time::Duration;

use super::RpcError;
use super::client::call;
use crate::xmlrpc::{Mismatch, Value};

/// A master, as one node sees it.
#[derive(Clone, Debug)]
pub struct Master {
    /// Such as `http://localhost:11311/`.
    pub uri: String,
    /// The node's full name.
    pub caller_id: String,
    /// For each call.
    pub timeout: Duration,
}

/// The master did not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum MasterError {
    #[error("cannot reach the master at {uri}: is roscore running, is ROS_MASTER_URI right? ({source})")]
    Unreachable { uri: String, source: RpcError },
    #[error("the master at {uri} refuses {method}: {text}")]
    Refused { uri: String, method: &'static str, text: String },
}

/// Who publishes, subscribes and serves what: names of nodes by name of topic or service.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SystemState {
    pub publishers: Vec<(String, Vec<String>)>,
    pub subscribers: Vec<(String, Vec<String>)>,
    pub services: Vec<(String, Vec<String>)>,
}

impl Master {
    /// Returns the slave APIs of those that subscribe.
    pub async fn register_publisher(&self, topic: &str, kind: &str, api: &str) -> Result<Vec<String>, MasterError> {
        self.ask("registerPublisher", [topic, kind, api], Value::into_strings).await
    }

    pub async fn unregister_publisher(&self, topic: &str, api: &str) -> Result<(), MasterError> {
        self.ask("unregisterPublisher", [topic, api], ignore).await
    }

    /// Returns the slave APIs of those that publish.
    pub async fn register_subscriber(&self, topic: &str, kind: &str, api: &str) -> Result<Vec<String>, MasterError> {
        self.ask("registerSubscriber", [topic, kind, api], Value::into_strings).await
    }

    pub async fn unregister_subscriber(&self, topic: &str, api: &str) -> Result<(), MasterError> {
        self.ask("unregisterSubscriber", [topic, api], ignore).await
    }

    /// `service_api`: `rosrpc://HOST:PORT`.
    pub async fn register_service(&self, service: &str, service_api: &str, api: &str) -> Result<(), MasterError> {
        self.ask("registerService", [service, service_api, api], ignore).await
    }

    pub async fn unregister_service(&self, service: &str, service_api: &str) -> Result<(), MasterError> {
        self.ask("unregisterService", [service, service_api], ignore).await
    }

    /// Where it is served, as `rosrpc://HOST:PORT`; refused if nobody does.
    pub async fn lookup_service(&self, service: &str) -> Result<String, MasterError> {
        self.ask("lookupService", [service], Value::into_string).await
    }

    /// The slave API of a node; refused if there is none of this name.
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

    /// Topics with their types; `*` where nobody has said one yet.
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
        let answer = call(&self.uri, method, params, self.timeout).await;
        answer.and_then(|value| Ok(read(value)?)).map_err(|error| match error {
            RpcError::Refused(text) => MasterError::Refused { uri: self.uri.clone(), method, text },
            source => MasterError::Unreachable { uri: self.uri.clone(), source },
        })
    }
}

/// How many registrations were taken back: none, if the master has started anew since.
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
