//! The stub of a proxy that is built without Zenoh. It refuses a graph of rmw_zenoh.

use std::convert::Infallible;
use std::marker::PhantomData;
use std::sync::Arc;

use bytes::Bytes;
use gdp_ros::call::Failure;
use gdp_ros::roster::{Kind, Offer};
use tokio::sync::watch;

use crate::config::ZenohConfig;
use crate::graph::event::{Event, GraphError, WriteError};
use crate::peer_proxies::PeerProxies;
use crate::ros2::{Graph, Qos, ServicePeer, TopicName, TypeName};

/// A graph that cannot exist: [`ZenohGraph::join`] never returns one.
pub struct ZenohGraph(Infallible);

/// A reader that cannot exist.
pub struct ZenohReader<'a>(Infallible, PhantomData<&'a ()>);

/// A writer that cannot exist.
pub struct ZenohWriter(Infallible);

/// A client that cannot exist.
pub struct ZenohClient(Infallible);

/// A server that cannot exist.
pub struct ZenohServer(Infallible);

/// A request that cannot exist.
pub struct ZenohReply(Infallible);

/// A reader of an action's topic that cannot exist.
pub struct ZenohFeed(Infallible);

/// Refuses the graph, because this program cannot join it.
pub fn check(_: &ZenohConfig) -> Result<(), GraphError> {
    Err(GraphError::WithoutZenoh)
}

impl ZenohGraph {
    pub fn join(_: &ZenohConfig, _: &str) -> Result<Self, GraphError> {
        Err(GraphError::WithoutZenoh)
    }

    pub fn peer_proxies(&self) -> &Arc<PeerProxies> {
        match self.0 {}
    }

    pub fn graph(&self) -> watch::Receiver<Arc<Graph>> {
        match self.0 {}
    }

    pub fn reader(&self, _: &TopicName, _: Option<&TypeName>, _: Option<Qos>) -> ZenohReader<'_> {
        match self.0 {}
    }

    pub fn writer(&self, _: &TopicName, _: &Kind, _: &[u8], _: Offer) -> Result<ZenohWriter, GraphError> {
        match self.0 {}
    }

    pub async fn client(
        &self,
        _: &TopicName,
        _: &TypeName,
        _: &ServicePeer,
    ) -> Result<(ZenohClient, Vec<u8>), GraphError> {
        match self.0 {}
    }

    pub async fn feed(&self, _: &(TopicName, TypeName), _: Qos, _: &ServicePeer) -> Result<ZenohFeed, GraphError> {
        match self.0 {}
    }

    pub fn server(&self, _: &TopicName, _: &TypeName, _: &[u8]) -> Result<ZenohServer, GraphError> {
        match self.0 {}
    }

    pub async fn leave(self) {
        match self.0 {}
    }
}

impl ZenohReader<'_> {
    pub async fn next(&mut self) -> Result<Event, GraphError> {
        match self.0 {}
    }

    pub fn again(&mut self) -> Result<(), GraphError> {
        match self.0 {}
    }
}

impl ZenohWriter {
    pub fn assign(&self, _: &str) {
        match self.0 {}
    }

    pub fn is_matched(&self) -> bool {
        match self.0 {}
    }

    pub async fn write(&self, _: Bytes, _: u64) -> Result<(), WriteError> {
        match self.0 {}
    }
}

impl ZenohClient {
    pub async fn call(&self, _: Bytes) -> Result<Bytes, Failure> {
        match self.0 {}
    }
}

impl ZenohServer {
    pub fn assign(&self, _: &str) {
        match self.0 {}
    }

    pub async fn next(&self) -> (Bytes, ZenohReply) {
        match self.0 {}
    }
}

impl ZenohReply {
    pub async fn send(self, _: Bytes) -> Result<(), String> {
        match self.0 {}
    }
}

impl ZenohFeed {
    pub async fn next(&self) -> Result<Bytes, String> {
        match self.0 {}
    }
}
