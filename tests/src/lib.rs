//! What the tests that need root are built from, and what `xtask demo` and `xtask bench` build from
//! as well.
//!
//! - [`netns`]: network namespaces, veth pairs, entering one and leaving it again
//! - [`chain`]: robot – switches – cloud; [`packet`]: what an eavesdropper or attacker does on its
//!   cables;
//!   [`wire`]: a cable that is bad
//! - [`ring`]: five daemons in a ring; [`replicas`]: three that are replicas of the RIB, on
//!   [`etcd`]
//! - [`federation`]: three trust domains, and a robot that roams between two of them
//! - [`dpdk`]: switches that DPDK forwards in
//! - [`fabric`]: the daemons and proxies on a chain; [`peers`]: the foreign DDS programs at its
//!   ends
//! - [`frames`]: frames byte by byte, and the forwarding cases of `fixtures/frames.json`
//! - [`measure`]: benchmarks: in turn, figures, tables, plots
//! - [`programs`]: every external program that is started
//! - [`process`]: programs that end when their guard is dropped, with their output kept
//! - [`wait`]: waiting for a condition with a deadline, never for a time
//! - [`tools`]: where the programs under test are
//!
//! Everything made here is removed when its guard is dropped, also by a panic or Ctrl-C.

pub mod chain;
pub mod dpdk;
pub mod etcd;
pub mod fabric;
pub mod federation;
pub mod frames;
pub mod measure;
pub mod netns;
pub mod packet;
pub mod peers;
pub mod process;
pub mod programs;
pub mod replicas;
pub mod ring;
pub mod schema;
pub mod tools;
pub mod wait;
pub mod wire;

pub use tools::Tools;
