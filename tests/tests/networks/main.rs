//! Tests that need root: real XDP, network namespaces, foreign programs. All are one executable,
//! because each would contain the whole daemon.

mod churn;
mod defaults;
mod doctor;
mod domain_keys;
mod domains;
mod dpdk;
mod ecn;
mod end_to_end;
mod evil;
mod fleet;
mod flows;
mod generated;
mod harness;
mod hostile;
mod inside;
mod kernel;
mod kernel_fib;
mod kernel_planes;
mod late;
mod link;
mod links;
mod liveness;
mod local_dds;
mod logs;
mod losses;
mod malicious;
mod onboarding;
mod pages;
mod pairings;
mod patient;
mod planes;
mod reach;
mod reach_links;
mod rekey;
mod replicas;
mod replication;
mod replication_udp;
mod restart;
mod ring;
mod roaming;
mod same_host;
mod selfheal;
mod selfheal_domains;
mod silence;
mod soak;
mod star;
mod trace;
mod traffic;
mod udp;
mod udp_fabric;
mod udp_runs;
mod wire;

// The tables of gdp-wire's tests, which `generated` uses, expect this path.
use gdp_tests::frames;
