//! Leadership among the replicas of a RIB: how long a leader may act, and which leader a switch
//! follows. It performs no I/O; `gdp-daemon` talks to etcd and to the switches.

pub mod fence;
pub mod lease;
