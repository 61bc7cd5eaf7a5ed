//! RustDDS as published, with the changes in `patches`. `build.rs` makes the source.

include!(concat!(env!("OUT_DIR"), "/src/lib.rs"));
