//! Services of any type: requests and replies are CDR, as they are on the wire without what a
//! [`Mapping`] adds.
//!
//! A service is two DDS topics. ROS 2's middlewares differ in how a reply says which request it
//! answers; what a peer speaks shows in its GUID, so both kinds can use one service at the same
//! time.

mod client;
mod mapping;
mod server;

pub use client::{CallError, Client};
pub use mapping::{Headless, Mapping, RequestId};
pub use server::{BadRequest, ClientLife, ReceivedRequest, Server};

use super::{Domain, Qos, RosError, TopicName, TypeName};

impl Domain {
    /// Offers a service (`/add_two_ints`, `example_interfaces/srv/AddTwoInts`), until the value is
    /// dropped. With no `mapping`, every client is answered in that of its vendor.
    pub fn server(&self, name: &TopicName, kind: &TypeName, mapping: Option<Mapping>) -> Result<Server, RosError> {
        let ([requests, replies], [request, response]) = (name.to_dds_service(), kind.of_service());
        let reader = self.raw_reader(name, &requests, &request, &Qos::default().into())?;
        let writer = self.raw_writer(name, &replies, &response, &Qos::default().into())?;
        Ok(Server::new(reader, writer, mapping, self.discovery.writers()))
    }

    /// Is a client of a service, in the mapping of its servers ([`Mapping::of`]), until the value
    /// is dropped. Needs a tokio runtime.
    pub fn client(&self, name: &TopicName, kind: &TypeName, mapping: Mapping) -> Result<Client, RosError> {
        let ([requests, replies], [request, response]) = (name.to_dds_service(), kind.of_service());
        let reader = self.raw_reader(name, &replies, &response, &Qos::default().into())?;
        let writer = self.raw_writer(name, &requests, &request, &Qos::default().into())?;
        Ok(Client::new(reader, writer, mapping))
    }
}
