//! The directory of a trust domain: its members with their labels, catalogs and shared topics. The
//! domain's join service publishes it sealed, and members follow it. [`service`] decides who
//! enters it. [`catalog`] lists what one member
//! exposes. This crate has no I/O and no clock.

pub mod catalog;
pub mod directory;
pub mod messages;
pub mod service;

use gdp_core::card::{CardError, NameCard};
use gdp_core::cert::{Grantee, TopicsOf};
use gdp_core::identity::VerifyKey;
use gdp_core::name::Metadata;
use gdp_e2e::seal::Encoding;
use gdp_wire::Name;

/// Label of the proxy on the domain's server, from which members import.
pub const SERVER: &str = "server";

/// Encoding number of a message that is a directory.
pub const DIRECTORY: Encoding = Encoding::Other(0x4744);

/// Encoding number of a request to the join service, and of its reply.
pub const JOIN: Encoding = Encoding::Other(0x474a);

/// Returns the card of a domain's directory. The key of the join service owns the name.
pub fn directory_card(join_service: VerifyKey) -> Result<NameCard, CardError> {
    card(join_service, "directory")
}

/// Returns the card of a domain's join service, whose key owns the name.
pub fn join_card(join_service: VerifyKey) -> Result<NameCard, CardError> {
    card(join_service, "join")
}

fn card(owner: VerifyKey, kind: &str) -> Result<NameCard, CardError> {
    NameCard::new(owner, Metadata::from([("kind".to_owned(), kind.to_owned())]))
}

/// Returns the rules by which a member imports topics from the server.
pub fn of_server(patterns: &[String]) -> Vec<TopicsOf> {
    match patterns {
        [] => Vec::new(),
        patterns => vec![TopicsOf { member: SERVER.into(), topics: patterns.to_vec() }],
    }
}

/// Returns the fingerprint of a machine for people to compare: the first 64 bits of its name.
pub fn fingerprint(entity: Name) -> String {
    let digits = entity.to_string();
    [0, 4, 8, 12].map(|at| &digits[at..at + 4]).join("-")
}

fn entity(name: Name) -> Grantee {
    Grantee::Entity(name)
}
