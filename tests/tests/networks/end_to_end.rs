//! Messages of unmodified DDS programs across three XDP switches, while parts start and stop.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::chain::ChainOptions;
use gdp_tests::fabric::{Fabric, FabricOptions, TOPIC, TYPE};
use gdp_tests::packet::{ETHERNET, is_gdp_data};
use gdp_tests::peers::{self, Conversation, Received, Side, Traffic, Vendor};
use gdp_tests::wait::{TIMEOUT, wait_for};
use gdp_wire::Header;
use serde_json::Value;

#[test]
fn cyclone_talks_to_fast_dds() -> Result<()> {
    crosses(Vendor::Cyclone, Vendor::FastDds)
}

#[test]
fn fast_dds_talks_to_cyclone() -> Result<()> {
    crosses(Vendor::FastDds, Vendor::Cyclone)
}

fn crosses(from: Vendor, to: Vendor) -> Result<()> {
    let chain = ChainOptions { wire: Some(1), ..Default::default() };
    let mut fabric = started(FabricOptions { chain, ..Default::default() })?;
    let traffic = Traffic { count: 40, ..Default::default() };
    let mut both = conversation(&fabric, from, to, &traffic)?;
    let before = kernel_forwards(&fabric)?;
    let eavesdropper = fabric.chain.wire_from_robot()?;
    both.open()?;
    let frame = eavesdropper.receive(TIMEOUT, is_gdp_data)?;
    let messages = both.finish(TIMEOUT, TIMEOUT)?;
    complete_and_intact(&messages, &traffic)?;

    for (i, (before, after)) in before.iter().zip(kernel_forwards(&fabric)?).enumerate() {
        ensure!(after - before >= traffic.count, "s{} forwarded only {} frames in the kernel", i + 1, after - before);
    }
    for word in [TOPIC, TYPE, &traffic.text, "chatter", "String", "hello"] {
        let seen = frame.windows(word.len()).any(|window| window.eq_ignore_ascii_case(word.as_bytes()));
        ensure!(!seen, "{word} can be read on the wire");
    }
    for process in fabric.robot.iter_mut().chain(&mut fabric.cloud) {
        process.check_alive()?;
    }
    Ok(())
}

#[test]
fn a_megabyte_crosses_whole() -> Result<()> {
    let fabric = started(FabricOptions::default())?;
    let traffic = Traffic { count: 5, rate: 2.0, size: 1 << 20, ..Default::default() };
    let mut both = conversation(&fabric, Vendor::Cyclone, Vendor::FastDds, &traffic)?;
    both.open()?;
    complete_and_intact(&both.finish(TIMEOUT, TIMEOUT)?, &traffic)
}

/// Each link finds its MTU, and follows the robot's interface when its MTU falls. The switches'
/// kernel forwards the frames.
#[test]
fn jumbo_frames_over_udp_cross_three_switches() -> Result<()> {
    let chain = ChainOptions { mtu: 9000, ..Default::default() };
    let mut fabric = started(FabricOptions { chain, udp: true, ..Default::default() })?;
    for i in 0..fabric.switches.len() {
        wait_for("links with jumbo frames", TIMEOUT, || {
            fabric.switches[i].process.check_alive()?;
            let status = fabric.status(i)?;
            let links = status["links"].as_array().into_iter().flatten();
            let jumbo = links.filter(|link| link["mtu"].as_u64().is_some_and(|mtu| mtu > 8900)).count();
            Ok((jumbo >= 2).then_some(()))
        })
        .with_context(|| fabric.status(i).unwrap_or_default().to_string())?;
    }
    // Until then a proxy sends frames of 1200 B.
    std::thread::sleep(gdp::unstable::SETTLING);
    // A message has 120 jumbo frames, or 760 of 1500 B, or 960 of 1200 B. Feedback comes as well.
    large_messages_have_frames(&fabric, 1000..2500)?;
    fabric.chain.robot().ip(&["link", "set", "r0", "mtu", "1500"])?;
    large_messages_have_frames(&fabric, 7000..9000)
}

/// Sends ten messages of 1 MB from the robot.
fn large_messages_have_frames(fabric: &Fabric, frames: Range<u64>) -> Result<()> {
    let traffic = Traffic { count: 10, rate: 2.0, size: 1 << 20, ..Default::default() };
    let mut both = conversation(fabric, Vendor::Cyclone, Vendor::FastDds, &traffic)?;
    let before = kernel_forwards(fabric)?;
    both.open()?;
    complete_and_intact(&both.finish(TIMEOUT, TIMEOUT)?, &traffic)?;
    for (before, after) in before.iter().zip(kernel_forwards(fabric)?) {
        ensure!(frames.contains(&(after - before)), "{} frames", after - before);
    }
    Ok(())
}

#[test]
fn a_killed_publisher_is_forgotten_everywhere_and_welcome_again() -> Result<()> {
    let mut fabric = started(FabricOptions::default())?;
    let last = fabric.switches.len() - 1;
    let name = fabric.name.clone();
    let writers = |fabric: &Fabric| -> Result<usize> {
        let answer = fabric.ctl(last, &["query", &name])?;
        let records = answer["records"].as_array().into_iter().flatten();
        Ok(records.filter(|record| record["role"] == "publisher").count())
    };
    wait_for("the RIB to know the writer", TIMEOUT, || Ok((writers(&fabric)? == 1).then_some(())))?;
    let mut robot = fabric.robot.take().expect("started");
    robot.kill()?;
    for i in [0, last] {
        fabric.wait_for_fib(i, false)?;
    }
    wait_for("the RIB to forget the writer", TIMEOUT, || Ok((writers(&fabric)? == 0).then_some(())))?;

    fabric.start_robot()?;
    fabric.wait_for_route()?;
    let traffic = Traffic { count: 10, ..Default::default() };
    let mut both = conversation(&fabric, Vendor::Cyclone, Vendor::FastDds, &traffic)?;
    both.open()?;
    complete_and_intact(&both.finish(TIMEOUT, TIMEOUT)?, &traffic)
}

#[test]
fn a_listener_that_joins_late_gets_what_comes_then() -> Result<()> {
    let mut fabric = Fabric::start(Tools::beside_this_test()?, FabricOptions::default())?;
    fabric.start_robot()?;
    let traffic = Traffic::default();
    let folder = fabric.folder().to_owned();
    let mut talker = peers::talker(&fabric.tools, fabric.chain.robot(), Vendor::Cyclone, &traffic, &folder)?;
    talker.wait_event("matched", TIMEOUT)?;
    // The talker has sent without a reader; now a reader starts.
    wait_for("messages that nobody reads", TIMEOUT, || Ok((sent(&fabric) > 2).then_some(())))?;
    fabric.start_cloud()?;
    fabric.wait_for_route()?;
    let mut listener = peers::listener(&fabric.tools, fabric.chain.cloud(), Vendor::FastDds, &traffic, &folder)?;
    let messages = listener
        .wait_until("ten messages", TIMEOUT, |p| Some(peers::received(p)).filter(|messages| messages.len() >= 10))?;
    ensure!(messages.iter().all(|m| m.intact), "{messages:?}");
    ensure!(messages[0].sequence > 0, "the listener cannot have heard the first message");
    ensure!(messages.windows(2).all(|pair| pair[0].sequence + 1 == pair[1].sequence), "a gap in {messages:?}");
    Ok(())
}

/// The robot's proxy stores the latched messages.
#[test]
fn the_last_messages_of_a_latched_topic_reach_who_comes_later() -> Result<()> {
    let (transient_local, depth) = (true, 3);
    let options = FabricOptions { transient_local, depth, ..Default::default() };
    let mut fabric = Fabric::start(Tools::beside_this_test()?, options)?;
    fabric.start_robot()?;
    let traffic = Traffic { count: 10, transient_local, depth, ..Default::default() };
    let folder = fabric.folder().to_owned();
    // The talker stays alive: as in ROS, latched messages disappear with their publisher.
    let _talker = peers::talker(&fabric.tools, fabric.chain.robot(), Vendor::Cyclone, &traffic, &folder)?;
    wait_for("all messages to be written", TIMEOUT, || Ok((sent(&fabric) == traffic.count).then_some(())))?;
    fabric.start_cloud()?;
    let mut listener = peers::listener(&fabric.tools, fabric.chain.cloud(), Vendor::FastDds, &traffic, &folder)?;
    let messages = listener
        .wait_until("the last message", TIMEOUT, |p| Some(peers::received(p)).filter(|all| all.len() >= depth as usize))
        .with_context(|| fabric.report())?;
    let numbers: Vec<i64> = messages.iter().map(|message| message.sequence).collect();
    ensure!(numbers == [7, 8, 9] && messages.iter().all(|message| message.intact), "{messages:?}");
    Ok(())
}

/// Each party has its own key, the name card and its certificate, and no secret of writer and
/// readers.
#[test]
fn parties_share_no_secret_and_the_owners_key_stays_with_the_owner() -> Result<()> {
    let fabric = started(FabricOptions::default())?;
    let traffic = Traffic { count: 10, ..Default::default() };
    let mut both = conversation(&fabric, Vendor::Cyclone, Vendor::FastDds, &traffic)?;
    both.open()?;
    complete_and_intact(&both.finish(TIMEOUT, TIMEOUT)?, &traffic)?;

    let mut parties = Vec::new();
    for party in ["robot", "cloud"] {
        let files = files_in(&fabric.folder_of(party))?;
        let names: Vec<&str> = files.keys().map(String::as_str).collect();
        ensure!(names == ["chatter.card", "chatter.cert", "key.pem", "proxy.yaml", "stats.json"], "{party}: {names:?}");
        parties.push(files);
    }
    let [robot, cloud] = &parties[..] else { unreachable!("two") };
    let shared: Vec<&String> = robot.keys().filter(|name| robot[*name] == cloud[*name]).collect();
    ensure!(shared == ["chatter.card"], "{shared:?}");
    let private = |text: &str| text.lines().filter(|line| !line.starts_with("-----")).collect::<String>();
    let owner = private(&files_in(&fabric.folder_of("owner"))?["owner.pem"]);
    ensure!(owner.len() > 100 && parties.iter().flat_map(|files| files.values()).all(|text| private(text) != owner));
    Ok(())
}

/// A second reader joins while messages flow, and continues to read after the first one's right is
/// revoked.
#[test]
fn a_revoked_reader_gets_nothing_of_the_next_epoch_and_the_others_all() -> Result<()> {
    let chain = ChainOptions { wire: Some(0), ..Default::default() };
    let mut fabric = started(FabricOptions { chain, ..Default::default() })?;
    let traffic = Traffic::default();
    let mut both = conversation(&fabric, Vendor::Cyclone, Vendor::FastDds, &traffic)?;
    both.open()?;
    let (at, interface) = fabric.chain.on_the_wire()?;
    at.enable_loopback_multicast()?;
    let _guest = fabric.admit_reader("guest", at, interface)?;
    let read_by = |label: &str| fabric.proxy_stats(label)["topics"][0]["messages"].as_u64().unwrap_or(0);
    wait_for("the guest to read", TIMEOUT, || Ok((read_by("guest") >= 10).then_some(())))
        .with_context(|| fabric.report())?;
    let from_robot = fabric.chain.wire_from_robot()?;
    let is_topic = |frame: &[u8]| is_gdp_data(frame) && destination(frame) == fabric.name;
    let before = epoch(&from_robot.receive(TIMEOUT, is_topic)?);

    let cloud = fabric.status(2)?["links"].as_array().into_iter().flatten().find(|l| l["role"] == "endpoint").cloned();
    let cloud = cloud.context("the cloud's link")?["peer"].as_str().context("its name")?.to_owned();
    let revoked = fabric.owner(1, &["grant", "revoke", "chatter.card", "--key", "owner.pem", "--entity", &cloud])?;
    let next = from_robot.receive(TIMEOUT, |frame| is_topic(frame) && epoch(frame) != before)?;
    ensure!(epoch(&next) > before, "epoch {} after {before}", epoch(&next));
    let readers = fabric.ctl(0, &["query", &fabric.name])?["records"].clone();
    let readers: Vec<_> = readers.as_array().into_iter().flatten().filter(|r| r["role"] == "subscriber").collect();
    ensure!(readers.len() == 1 && readers[0]["entity"] != *cloud, "{revoked}: {readers:?}");

    // Messages in flight have arrived by the time the guest has read more.
    let guest_reads_on = || {
        let so_far = read_by("guest");
        wait_for("the guest to read on", TIMEOUT, || Ok((read_by("guest") >= so_far + 20).then_some(())))
    };
    // Each proxy updates its statistics once a second.
    (0..3).try_for_each(|_| guest_reads_on())?;
    let so_far = (read_by("cloud"), peers::received(&both.listener).len());
    (0..3).try_for_each(|_| guest_reads_on())?;
    ensure!((read_by("cloud"), peers::received(&both.listener).len()) == so_far, "the revoked reader reads on");
    both.listener.check_alive()?;

    // The revoked reader also cannot rejoin.
    fabric.cloud.take().context("started")?.stop(TIMEOUT)?;
    fabric.start_cloud()?;
    let status = |fabric: &Fabric| fabric.proxy_stats("cloud")["topics"][0]["status"].as_str().map(str::to_owned);
    wait_for("the cloud to be refused", TIMEOUT, || Ok(status(&fabric).filter(|s| s.contains("revoked")).map(drop)))
        .with_context(|| format!("{:?}", status(&fabric)))
}

/// Short-lived certificates replace the robot's and then the reader's, and others replace these
/// before they expire.
#[test]
fn certificates_are_renewed_and_messages_flow_over_the_end_of_the_old_ones() -> Result<()> {
    const SHORT: u64 = 15;
    let fabric = started(FabricOptions::default())?;
    let traffic = Traffic { count: 500, ..Default::default() };
    let mut both = conversation(&fabric, Vendor::Cyclone, Vendor::FastDds, &traffic)?;
    both.open()?;
    let shown = fabric.ctl(0, &["query", &fabric.name])?["records"].clone();
    let entity = |role: &str| -> Result<String> {
        let record = shown.as_array().into_iter().flatten().find(|record| record["role"] == role);
        Ok(record.and_then(|record| record["entity"].as_str()).context("a record")?.to_owned())
    };
    let parties = [("robot", "--publish", entity("publisher")?), ("cloud", "--read", entity("subscriber")?)];
    let renew = |time: &str, took: &dyn Fn(u64) -> bool| -> Result<()> {
        for (party, right, entity) in &parties {
            let whom = ["--entity", entity, right, "--for", time, "-o", "renewed"];
            fabric.owner(1, &[&["grant", "add", "chatter.card", "--key", "owner.pem"], &whom[..]].concat())?;
            let (renewed, cert) = (fabric.folder_of("owner").join("renewed"), fabric.folder_of(party));
            std::fs::rename(&renewed, cert.join("chatter.cert"))?;
        }
        let taken = || -> Result<Option<()>> {
            let records = fabric.ctl(0, &["query", &fabric.name])?["records"].clone();
            let left = |record: &Value| record["expires_in"].as_u64().is_some_and(took);
            Ok(records.as_array().is_some_and(|all| all.len() == 2 && all.iter().all(left)).then_some(()))
        };
        wait_for("the RIB to have the new certificates", TIMEOUT, taken).with_context(|| fabric.report())
    };
    renew(&format!("{SHORT}s"), &|left| left <= SHORT)?;
    let ended = Instant::now() + Duration::from_secs(SHORT + 1);
    renew("1h", &|left| left > SHORT)?;
    ensure!(Instant::now() < ended, "too late to show anything");
    complete_and_intact(&both.finish(2 * TIMEOUT, TIMEOUT)?, &traffic)?;
    ensure!(Instant::now() > ended, "the messages were over before the certificates");
    for (party, ..) in &parties {
        let status = fabric.proxy_stats(party)["topics"][0]["status"].clone();
        ensure!(status == "up", "{party}: {status}");
    }
    Ok(())
}

/// Without a reader, the robot does not send its messages, and no switch has a route for the name.
#[test]
fn what_nobody_reads_goes_nowhere() -> Result<()> {
    let mut fabric = Fabric::start(Tools::beside_this_test()?, FabricOptions::default())?;
    fabric.start_robot()?;
    let folder = fabric.folder().to_owned();
    let traffic = Traffic::default();
    let _talker = peers::talker(&fabric.tools, fabric.chain.robot(), Vendor::FastDds, &traffic, &folder)?;
    wait_for("messages that nobody reads", TIMEOUT, || Ok((sent(&fabric) >= 10).then_some(())))?;
    ensure!(!fabric.holds_name(0)?, "no subscriber, so nothing may be in the FIB");
    let frames = &fabric.proxy_stats("robot")["topics"][0]["fabric"]["frames"];
    ensure!(*frames == 0, "{frames} frames were sent to nobody");
    for i in 0..fabric.switches.len() {
        ensure!(forwards(&fabric, i)? == 0, "s{} forwarded frames to nobody", i + 1);
    }
    Ok(())
}

fn started(options: FabricOptions) -> Result<Fabric> {
    let mut fabric = Fabric::start(Tools::beside_this_test()?, options)?;
    fabric.start_proxies()?;
    Ok(fabric)
}

fn conversation(fabric: &Fabric, from: Vendor, to: Vendor, traffic: &Traffic) -> Result<Conversation> {
    let talks = Side { at: fabric.chain.robot(), vendor: from, traffic };
    let hears = Side { at: fabric.chain.cloud(), vendor: to, traffic };
    Conversation::start(&fabric.tools, talks, hears, fabric.folder()).map_err(|e| e.context(fabric.report()))
}

fn complete_and_intact(messages: &[Received], traffic: &Traffic) -> Result<()> {
    let sequences: Vec<i64> = messages.iter().map(|message| message.sequence).collect();
    ensure!(sequences == (0..traffic.count as i64).collect::<Vec<_>>(), "expected all, once, in order: {sequences:?}");
    ensure!(messages.iter().all(|m| m.intact && m.bytes == traffic.size as u64), "damaged: {messages:?}");
    ensure!(messages.iter().all(|m| m.latency < Duration::from_secs(5)), "late: {messages:?}");
    Ok(())
}

fn kernel_forwards(fabric: &Fabric) -> Result<Vec<u64>> {
    (0..fabric.switches.len()).map(|i| fabric.forwarded_in_kernel(i)).collect()
}

/// Returns names and content of the files in a folder.
fn files_in(folder: &Path) -> Result<BTreeMap<String, String>> {
    let mut files = BTreeMap::new();
    for file in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let file = file?;
        files.insert(file.file_name().to_string_lossy().into_owned(), std::fs::read_to_string(file.path())?);
    }
    Ok(files)
}

/// Returns the destination of a data frame, 64 hex digits.
fn destination(frame: &[u8]) -> String {
    frame[ETHERNET + 32..ETHERNET + 64].iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Returns the epoch of the first segment in a data frame.
fn epoch(frame: &[u8]) -> u32 {
    let at = ETHERNET + size_of::<Header>() + 40;
    frame[at..at + 4].iter().fold(0, |epoch, byte| epoch << 8 | u32::from(*byte))
}

/// Returns the number of messages that the robot's proxy received from DDS.
fn sent(fabric: &Fabric) -> u64 {
    fabric.proxy_stats("robot")["topics"][0]["messages"].as_u64().unwrap_or(0)
}

/// Returns the data frames that any plane of switch `i` forwarded.
fn forwards(fabric: &Fabric, i: usize) -> Result<u64> {
    Ok(fabric.counter(i, "forwarded")? + fabric.counter(i, "delivered")?)
}
