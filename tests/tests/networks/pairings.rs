//! Every source at every sink: nodes of rospy, Cyclone DDS and Fast DDS publish each type, and each of the three hears all of it, byte for
//! byte as another implementation (rosbags) lays the message out. One type is of a package that no distribution has.
//!
//! ```text
//!                         ┌ p1 ── l0 old: rospy at a master
//!   robot r0 ── p0 switch ┤
//!   all three             └ p2 ── l0 new: Cyclone DDS, Fast DDS
//! ```

mod site;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use anyhow::{Result, bail, ensure};

use self::site::{KEYS, Site, Vendor};

/// With everything started at once on two cores.
const PATIENCE: Duration = Duration::from_secs(90);

#[test]
fn every_source_is_heard_at_every_sink_with_every_type() -> Result<()> {
    let mut site = Site::start()?;
    let talkers = Vendor::ALL.map(|vendor| site.talk(vendor)).into_iter().collect::<Result<Vec<_>>>()?;
    let listeners = Vendor::ALL.map(|vendor| site.listen(vendor)).into_iter().collect::<Result<Vec<_>>>()?;
    site.programs = talkers;
    let deadline = Instant::now() + PATIENCE;
    loop {
        let mut missing = Vec::new();
        for (sink, listener) in Vendor::ALL.iter().zip(&listeners) {
            let mut heard: BTreeMap<String, bool> = BTreeMap::new();
            for line in listener.json_lines().iter().filter(|line| line["event"] == "message") {
                let topic = line["topic"].as_str().unwrap_or_default().to_owned();
                ensure!(line["same"] == true, "{sink:?} hears {topic} changed\n{}", site.report());
                heard.insert(topic, true);
            }
            let all = Vendor::ALL.iter().flat_map(|source| KEYS.map(|key| source.topic(key)));
            missing.extend(all.filter(|topic| !heard.contains_key(topic)).map(|topic| format!("{topic} at {sink:?}")));
        }
        if missing.is_empty() {
            return Ok(());
        }
        if Instant::now() >= deadline {
            let listeners: String = listeners.iter().map(|listener| listener.stderr()).collect();
            bail!("not heard in {PATIENCE:?}: {missing:?}\n{}\n{listeners}", site.report());
        }
        site.check_alive()?;
        std::thread::sleep(Duration::from_millis(200));
    }
}
