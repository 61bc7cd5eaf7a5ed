//! DPDK as bindgen reads it, and the shim around its inline functions. Raw: only the modules beside
//! this one use it.
#![allow(non_camel_case_types, non_upper_case_globals, non_snake_case, dead_code)]
#![allow(clippy::all, clippy::undocumented_unsafe_blocks, reason = "made by bindgen")]

include!(concat!(env!("OUT_DIR"), "/dpdk.rs"));
