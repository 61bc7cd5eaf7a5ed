//! Services of any type. Requests and replies are CDR in their wire format, without what a
//! [`Mapping`] adds.
//!
//! A service consists of two DDS topics. ROS 2's middlewares differ in how a reply identifies its
//! request. The GUID of a peer shows its mapping, so both kinds can use one service at the same
//! time.

mod client;
mod mapping;
mod server;

pub use client::{CallError, DdsClient};
pub use mapping::{Headless, Mapping, RequestId};
pub use server::{BadRequest, ClientLife, ReceivedRequest, Server};

use super::{Domain, Qos, RosError, TopicName, TypeName};

impl Domain {
    /// Offers a service (`/add_two_ints`, `example_interfaces/srv/AddTwoInts`) until the value is
    /// dropped. Without `mapping`, each client is answered in the mapping of its vendor.
    pub fn server(&self, name: &TopicName, kind: &TypeName, mapping: Option<Mapping>) -> Result<Server, RosError> {
        let ([requests, replies], [request, response]) = (name.to_dds_service(), kind.of_service());
        let reader = self.raw_reader(name, &requests, &request, &[], &Qos::default().into())?;
        let writer = self.raw_writer(name, &replies, &response, &[], &Qos::default().into())?;
        Ok(Server::new(reader, writer, mapping, self.discovery.writers()))
    }

    /// Creates a client of a service, in the mapping of its servers ([`Mapping::of`]). Needs a
    /// tokio runtime.
    pub fn client(&self, name: &TopicName, kind: &TypeName, mapping: Mapping) -> Result<DdsClient, RosError> {
        let ([requests, replies], [request, response]) = (name.to_dds_service(), kind.of_service());
        let reader = self.raw_reader(name, &replies, &response, &[], &Qos::default().into())?;
        let writer = self.raw_writer(name, &requests, &request, &[], &Qos::default().into())?;
        Ok(DdsClient::new(reader, writer, mapping))
    }
}
