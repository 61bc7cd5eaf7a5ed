//! Every source with every sink: nodes of rospy, Cyclone DDS and Fast DDS publish each type. Each
//! of the three receives all messages, byte for byte as another implementation (rosbags) serializes
//! them. One type is from a package that no distribution has.

use std::collections::BTreeMap;
use std::fs;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use gdp_tests::Tools;
use gdp_tests::netns::{Namespace, execute};
use gdp_tests::process::Process;
use gdp_tests::programs::Executable as _;
use serde_json::{Value, json};

use super::site::{Carried, Site, Vendor};

/// Limit with everything started at once on two cores.
const TIMEOUT: Duration = Duration::from_secs(90);

/// The published messages: the files of `samples.py`.
const KEYS: [&str; 6] = ["string", "image", "cloud", "joints", "tf", "report"];

#[test]
fn every_source_is_heard_at_every_sink_with_every_type() -> Result<()> {
    let (mut site, types) = start()?;
    let talkers = Vendor::ALL.map(|vendor| talk(&site, vendor, &types)).into_iter().collect::<Result<Vec<_>>>()?;
    let listeners = Vendor::ALL.map(|vendor| listen(&site, vendor, &types)).into_iter().collect::<Result<Vec<_>>>()?;
    site.programs = talkers;
    let deadline = Instant::now() + TIMEOUT;
    loop {
        let mut missing = Vec::new();
        for (sink, listener) in Vendor::ALL.iter().zip(&listeners) {
            let mut heard: BTreeMap<String, bool> = BTreeMap::new();
            for line in listener.json_lines().iter().filter(|line| line["event"] == "message") {
                let topic = line["topic"].as_str().unwrap_or_default().to_owned();
                ensure!(line["same"] == true, "{sink:?} hears {topic} changed\n{}", site.report());
                heard.insert(topic, true);
            }
            let all = Vendor::ALL.iter().flat_map(|source| KEYS.map(|key| source.name(key)));
            missing.extend(all.filter(|topic| !heard.contains_key(topic)).map(|topic| format!("{topic} at {sink:?}")));
        }
        if missing.is_empty() {
            return Ok(());
        }
        if Instant::now() >= deadline {
            let listeners: String = listeners.iter().map(|listener| listener.stderr()).collect();
            bail!("not heard in {TIMEOUT:?}: {missing:?}\n{}\n{listeners}", site.report());
        }
        site.check_alive()?;
        std::thread::sleep(Duration::from_millis(200));
    }
}

/// Starts everything except the talkers and listeners, and returns ROS 2's type names by key. Only
/// the robot's proxy has the unknown package's type definition, from a folder.
fn start() -> Result<(Site, Value)> {
    let (tools, files) = (Tools::beside_this_test()?, Site::files()?);
    let folder = files.path();
    execute(tools.python()?.command().arg(tools.peer("any/samples.py")).arg(folder))?;
    let index: Value = serde_json::from_str(&fs::read_to_string(folder.join("index.json"))?)?;
    let types: Value = KEYS.iter().map(|key| ((*key).to_owned(), index[key]["type"].clone())).collect();
    let mut carried = Vec::new();
    for source in Vendor::ALL {
        for key in KEYS {
            let kind = types[key].as_str().context("a type")?.to_owned();
            carried.push(Carried { what: "topic", name: source.name(key), kind, source });
        }
    }
    let definitions = json!({"definitions": {"ros2": [folder.join("share")]}});
    Ok((Site::start(tools, files, &carried, definitions)?, types))
}

/// Publishes every type under `/VENDOR`.
fn talk(site: &Site, vendor: Vendor, types: &Value) -> Result<Process> {
    program(site, vendor, "talk", &site.robot, types, &[&format!("/{}", vendor.label())])
}

/// Subscribes to every type from each vendor.
fn listen(site: &Site, vendor: Vendor, types: &Value) -> Result<Process> {
    let prefixes = Vendor::ALL.map(|source| format!("/{}", source.label()));
    program(site, vendor, "listen", site.sink(vendor), types, &prefixes.each_ref().map(String::as_str))
}

fn program(
    site: &Site,
    vendor: Vendor,
    verb: &str,
    at: &Namespace,
    types: &Value,
    prefixes: &[&str],
) -> Result<Process> {
    let mut command = match vendor {
        Vendor::Rospy => site.ros1(at, "any/rospy_any.py")?,
        Vendor::Cyclone => site.python(at, "any/cyclone_any.py")?,
        Vendor::FastDds => at.command(site.tools.fastdds_any()?)?,
    };
    command.arg(verb).arg(site.folder());
    if vendor == Vendor::FastDds {
        let types = KEYS.map(|key| format!("{key}={}", types[key].as_str().unwrap_or_default()));
        command.arg(prefixes.join(",")).args(types);
    } else {
        command.args(prefixes);
    }
    site.spawn(&format!("{}-{verb}", vendor.label()), command)
}
