//! Finds the installed DPDK, compiles the shim around its inline functions, and generates bindings
//! for the others with bindgen.

use std::env;
use std::path::PathBuf;

/// Linked libraries; DPDK loads its drivers at startup.
const LIBRARIES: [&str; 5] = ["rte_eal", "rte_ethdev", "rte_mbuf", "rte_mempool", "rte_ring"];

/// The releases with stable ABI 23: see docs/dpdk.md.
const MAJORS: [&str; 3] = ["22.11", "23.03", "23.07"];

const FUNCTIONS: &str = "rte_(eal_init|strerror|thread_register|thread_unregister|dev_probe|dev_remove|\
    mempool_free|mempool_in_use_count|\
    eth_dev_(get_port_by_name|info_get|configure|start|stop|close|socket_id|adjust_nb_rx_tx_desc)|\
    eth_(rx_queue_setup|tx_queue_setup|promiscuous_enable|macaddr_get|stats_get|link_get_nowait))";

fn main() {
    println!("cargo::rerun-if-changed=shim/shim.c");
    println!("cargo::rerun-if-changed=shim/shim.h");
    let dpdk = pkg_config::Config::new().cargo_metadata(false).probe("libdpdk").unwrap_or_else(|error| {
        fail(&format!("libdpdk is not found by pkg-config: {error}"));
    });
    if !MAJORS.iter().any(|major| dpdk.version.starts_with(major)) {
        fail(&format!("DPDK {} is installed; this crate is written for {}", dpdk.version, MAJORS.join(" or ")));
    }
    // Of the pkg-config output, the compiler needs the include paths, the configuration header and
    // the instruction set.
    let mut flags: Vec<String> = dpdk.include_paths.iter().map(|path| format!("-I{}", path.display())).collect();
    flags.extend(["-include".to_owned(), "rte_config.h".to_owned()]);
    if env::var("CARGO_CFG_TARGET_ARCH").as_deref() == Ok("x86_64") {
        flags.push("-march=corei7".to_owned());
    }

    let mut shim = cc::Build::new();
    shim.file("shim/shim.c").opt_level(2).warnings(false);
    flags.iter().for_each(|flag| {
        shim.flag(flag);
    });
    shim.compile("gdp_dpdk_shim");
    dpdk.link_paths.iter().for_each(|path| println!("cargo::rustc-link-search=native={}", path.display()));
    LIBRARIES.iter().for_each(|library| println!("cargo::rustc-link-lib={library}"));

    let bindings = bindgen::Builder::default()
        .header("shim/shim.h")
        .clang_args(&flags)
        .allowlist_function(FUNCTIONS)
        .allowlist_function("gdp_.*")
        .allowlist_type("rte_eth_(conf|dev_info|stats|link)")
        .allowlist_var("GDP_.*|RTE_PKTMBUF_HEADROOM")
        .opaque_type("rte_(mempool|mbuf|device|eth_rxconf|eth_txconf)")
        .layout_tests(false)
        .generate_comments(false)
        .derive_default(true)
        .generate()
        .unwrap_or_else(|error| fail(&format!("bindgen cannot read DPDK's headers: {error}")));
    let out = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default()).join("dpdk.rs");
    bindings.write_to_file(&out).unwrap_or_else(|error| fail(&format!("{}: {error}", out.display())));
}

fn fail(what: &str) -> ! {
    eprintln!(
        "{what}\nThe DPDK data plane needs DPDK 22.11 with its headers, and libclang: `cargo xtask setup dpdk` \
         installs them \
               on Debian 12; elsewhere install libdpdk-dev, the drivers (dpdk) and libclang."
    );
    std::process::exit(1);
}
