//! Harness of the tests that need root, also used by `xtask demo` and `xtask bench`.
//!
//! - [`netns`]: network namespaces, veth pairs, entering a namespace and leaving it again
//! - [`book`]: the documents, their commands, and the pages that are written from the code
//! - [`chain`]: robot – switches – cloud; [`packet`]: eavesdropping and injection on its
//!   cables; [`wire`]: a cable with faults
//! - [`ring`]: five daemons in a ring; [`replicas`]: three replicas of the RIB, on [`etcd`]
//! - [`federation`]: three trust domains, and a robot that roams between two of them
//! - [`dpdk`]: switches with a DPDK data plane
//! - [`dds_domain`]: a DDS domain for each test
//! - [`fabric`]: the daemons and proxies on a chain; [`peers`]: the foreign DDS programs at its
//!   ends
//! - [`topics`]: topics between robot and cloud, and the proxies that carry them
//! - [`frames`]: frames byte by byte, and the forwarding cases of `fixtures/frames.json`
//! - [`measure`]: benchmarks: rounds, figures, tables, plots
//! - [`system_calls`]: how many system calls programs make
//! - [`programs`]: every external program that is started
//! - [`process`]: programs that end when their guard is dropped, and their captured output
//! - [`wait`]: waiting for a condition with a deadline, never for a fixed time
//! - [`tools`]: paths of the programs under test
//!
//! Dropping the guard of a resource removes the resource, also after a panic or Ctrl-C.

pub mod book;
pub mod bridge;
pub mod chain;
pub mod dds_domain;
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
pub mod system_calls;
pub mod tools;
pub mod topics;
pub mod wait;
pub mod wire;

pub use tools::Tools;
