//! The library and the program as others use them. One program of all these tests: each would
//! contain the whole daemon.

mod cli;
mod cluster;
mod daemon;
mod domain_links;
mod domains;
mod etcd;
mod federation;
mod fenced;
mod grants;
mod hostile_text;
mod inboxes;
mod member;
mod owner;
mod ports;
mod probes;
mod replicas;
mod resigning;
mod revocations;
mod services;
mod switch;
mod topics;
mod traces;
mod user;
