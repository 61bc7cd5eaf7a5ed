//! DPDK bindings from bindgen, and the shim around inline functions. This is the raw interface;
//! only the other modules of this crate use it.
#![allow(non_camel_case_types, non_upper_case_globals, non_snake_case, dead_code)]
#![allow(clippy::all, clippy::undocumented_unsafe_blocks, reason = "made by bindgen")]

include!(concat!(env!("OUT_DIR"), "/dpdk.rs"));
