//! The table of pairings in `docs/ros.md`: each software with Kilted's rclpy through two proxies
//! and a switch, in both directions, on loopback and without root.
//!
//! ```text
//!   software of the row ── proxy ── switch, RIB ── proxy ── rclpy
//! ```
//!
//! `cargo xtask pairings` has a report of all cells written. Without it, as in CI, the test demands
//! that the first columns hold.

mod capability;
#[path = "../hub/mod.rs"]
mod hub;
#[allow(dead_code, reason = "the tests of the ROS 1 node, whose it is, use the rest")]
#[path = "../../../crates/gdp-ros1/tests/rospy/master.rs"]
mod master;
#[allow(dead_code, reason = "the tests of bridges, whose it is, use the rest")]
#[path = "../bridge/site.rs"]
mod site;
mod software;

use gdp_tests::dds_domain::lease;
use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use capability::Capability;
use master::Master;
use site::Site;
use software::{End, Software};

/// The file that receives the report.
const REPORT: &str = "GDP_PAIRINGS_REPORT";

/// The columns that CI tries.
const QUICK: [Capability; 1] = [Capability::Topics];

/// The definition of the action, which no proxy has by itself.
const FIBONACCI: &str = "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n";

/// The services behind `ros2 param`.
const PARAMETERS: &str = "/**/list_parameters, /**/get_parameters, /**/set_parameters, /**/get_parameter_types, \
                          /**/describe_parameters, /**/set_parameters_atomically";

#[tokio::test(flavor = "multi_thread")]
async fn every_software_exchanges_with_rclpy_elsewhere_what_the_table_says() {
    let report = std::env::var_os(REPORT);
    let columns: &[Capability] = if report.is_some() { &Capability::ALL } else { &QUICK };
    let mut rows = serde_json::Map::new();
    for software in Software::ALL {
        rows.insert(software.label().to_owned(), row(software, columns).await);
    }
    match report {
        // The report says what each cell is.
        Some(report) => {
            let columns: Vec<_> = columns.iter().map(|column| column.label()).collect();
            fs::write(report, json!({"columns": columns, "rows": rows}).to_string()).unwrap();
        }
        None => {
            for (software, row) in rows {
                columns.iter().for_each(|column| assert_eq!(row[column.label()], "yes", "{software}"));
            }
        }
    }
}

/// The cells of a software: `yes`, `– (reason)`, or `no: ` and what failed.
async fn row(software: Software, capabilities: &[Capability]) -> Value {
    let site = Site::start().await;
    let master = Master::start().await;
    let (near, far) = (lease(), lease());
    let folder = site.folder("programs");
    let uri = master.config("/unused").master_uri;
    let port = uri.trim_end_matches('/').rsplit(':').next().unwrap().parse().unwrap();
    let robot = End { software, domain: near, master: port, folder: &folder };
    let cloud = End { software: Software::Kilted, domain: far, master: 0, folder: &folder };
    let graph = if software.is_ros1() { format!("{{master: '{uri}', host: localhost}}") } else { domain(near) };
    let _proxies = proxies(&site, [&graph, &domain(far)]);

    let mut cells = serde_json::Map::new();
    for &capability in capabilities {
        let cell = match capability.absent(software) {
            Some(reason) => format!("– ({reason})"),
            None => [("there", &robot, &cloud), ("back", &cloud, &robot)]
                .into_iter()
                .find_map(|(way, from, to)| {
                    let name = format!("{}_{way}", capability.label());
                    let error = capability.run(from, to, &name).err()?;
                    eprintln!("{software:?} {name}: {error:?}\n{}\n{}", site.log("robot"), site.log("cloud"));
                    // The causes before contain the output of the programs.
                    let cause = error.root_cause().to_string();
                    Some(format!("no: {way}, {}", cause.lines().next().unwrap_or_default()))
                })
                .unwrap_or_else(|| "yes".to_owned()),
        };
        println!("{software:?} {}: {cell}", capability.label());
        cells.insert(capability.label().to_owned(), cell.into());
    }
    cells.into()
}

/// Two proxies that carry everything of the cases both ways.
fn proxies(site: &Site, graphs: [&str; 2]) -> [site::Proxy; 2] {
    let patterns = format!("topics: [/pair/**], services: [/pair/**, {PARAMETERS}], actions: [/pair/**]");
    let (out, taken) = site.by_pattern("robot", "cloud", &patterns, &patterns);
    let (back, received) = site.by_pattern("cloud", "robot", &patterns, &patterns);
    let definitions = "definitions: {ros1: [share], ros2: [share]}\n";
    for label in ["robot", "cloud"] {
        share(&site.folder(label));
    }
    [
        site.begin("robot", graphs[0], &format!("{out}{received}{definitions}")),
        site.begin("cloud", graphs[1], &format!("{back}{taken}{definitions}")),
    ]
}

fn share(folder: &Path) {
    let folder = folder.join("share/test_msgs/action");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("Fibonacci.action"), FIBONACCI).unwrap();
}

fn domain(id: u16) -> String {
    format!("{{domain_id: {id}}}")
}
