//! Tests of the library and the program from the outside. They form a single program, because each
//! separate program would contain the whole daemon.

mod attached;
mod browser;
mod cli;
#[cfg(feature = "etcd")]
mod cluster;
mod daemon;
mod domain_links;
mod domains;
#[cfg(feature = "etcd")]
mod etcd;
mod federation;
mod fenced;
mod grants;
mod hostile_text;
mod inboxes;
mod member;
mod metrics;
mod owner;
mod ports;
mod probes;
#[cfg(feature = "etcd")]
mod replicas;
mod replies;
#[cfg(feature = "etcd")]
mod resigning;
mod revocations;
#[cfg(feature = "etcd")]
mod secured_etcd;
mod services;
mod switch;
mod topics;
mod traces;
mod user;
mod web;
