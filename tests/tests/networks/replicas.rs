//! Replicas of the RIB on three switches that forward in the kernel. The leading daemon and the
//! leading member of etcd are killed at once under traffic, then others.

use std::collections::BTreeMap;
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use gdp_ctl::client::Client;
use gdp_proto::admin::Request;
use gdp_proto::control::{EntityRequest, NameRole, Record, Response};
use gdp_tests::Tools;
use gdp_tests::replicas::{CLOUD_AT, FIRST_LEADER, ROBOT_AT, Replicas};
use gdp_tests::wait::TIMEOUT;
use gdp_wire::Name;

use crate::traffic::Traffic;

/// The serial of each entity's statement about a name in a role.
type Serials = BTreeMap<(Name, NameRole, Name), u64>;

#[test]
fn nothing_stops_when_the_leading_daemon_and_a_member_of_etcd_are_killed_at_once() -> Result<()> {
    let mut replicas = Replicas::start(Tools::beside_this_test()?)?;
    ensure!(replicas.leader()? == FIRST_LEADER);
    let parties = (replicas.folder_of("robot"), replicas.folder_of("cloud"));
    let traffic = Traffic::start((&replicas.robot, parties.0), (&replicas.cloud, parties.1))?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| replicas.report())?;
    let before = serials(&replicas)?;
    ensure!(before.len() == 2, "one writer and one reader: {before:?}");
    ensure!(forwarded(&replicas)? > 0, "it goes by the switch whose daemon leads");

    let member = replicas.etcd.leader(&replicas.nodes[ROBOT_AT])?;
    let killed = Instant::now();
    replicas.kill(FIRST_LEADER, member)?;
    replicas.wait("another replica to lead", |replicas| {
        let leader = replicas.leader()?;
        let known = &replicas.ctl(leader, &["status"])?["rib"]["switches"];
        Ok(known.as_u64() >= Some(2) && serials(replicas)? == before)
    })?;
    let led = killed.elapsed();
    let second = replicas.leader()?;

    // Another owner's topic, with a robot and a cloud that no replica knows yet.
    let parties = (replicas.folder_of_late("robot"), replicas.folder_of_late("cloud"));
    let later = Traffic::start((&replicas.late[0], parties.0), (&replicas.late[1], parties.1))
        .with_context(|| replicas.report())?;
    later.wait_for_more(500, TIMEOUT).with_context(|| replicas.report())?;
    println!("another replica led after {led:?}, a new topic had messages after {:?}", killed.elapsed());
    traffic.wait_for_more(500, TIMEOUT).with_context(|| replicas.report())?;
    traffic.nothing_is_missing().with_context(|| replicas.report())?;
    let both = serials(&replicas)?;
    ensure!(both.len() == 4 && before.iter().all(|entry| both.get(entry.0) == Some(entry.1)), "{both:?}");

    replicas.start_again(FIRST_LEADER, member)?;
    replicas.wait_until_whole()?;
    ensure!(replicas.leader()? == second, "who was killed follows");
    ensure!(serials(&replicas)? == both);

    // Kills a following daemon at the cloud or the robot, and a following member: the others
    // suffice.
    let follower = if second == CLOUD_AT { ROBOT_AT } else { CLOUD_AT };
    let members = 0..replicas.nodes.len();
    let leading = replicas.etcd.leader(&replicas.nodes[FIRST_LEADER])?;
    let member = members.into_iter().find(|member| *member != leading).context("three members")?;
    replicas.kill(follower, member)?;
    traffic.wait_for_more(500, TIMEOUT).with_context(|| replicas.report())?;
    replicas.start_again(follower, member)?;
    replicas.wait_until_whole()?;
    ensure!(replicas.leader()? == second, "nobody else was needed");
    // The ends have new links, and the same or newer statements.
    replicas.wait("all names to be listed", |replicas| {
        let now = serials(replicas)?;
        Ok(now.keys().eq(both.keys()) && now.iter().all(|(of, serial)| *serial >= both[of]))
    })?;
    for traffic in [&traffic, &later] {
        traffic.wait_for_more(500, TIMEOUT).with_context(|| replicas.report())?;
        let sent = traffic.stop_sending();
        traffic.wait_for_total(sent, TIMEOUT).with_context(|| traffic.summary() + &replicas.report())?;
        traffic.nothing_is_missing().with_context(|| replicas.report())?;
    }
    Ok(())
}

/// Returns all statements that the leader lists, as a query at its switch returns them.
fn serials(replicas: &Replicas) -> Result<Serials> {
    let leader = replicas.leader()?;
    let listed = replicas.ctl(leader, &["rib", "dump"])?["records"].clone();
    let names = listed.as_array().into_iter().flatten().filter_map(|record| record["name"].as_str());
    let mut client = Client::connect(replicas.switches[leader].socket())?;
    let mut serials = Serials::new();
    for name in names {
        let name: Name = name.parse()?;
        let request = EntityRequest::Query { prefix: name.into(), after: None };
        let asked = client.ask::<Response>(&Request::Entity { entity: None, request: request.into() })?;
        let Response::Records { records, .. } = asked else { bail!("{asked:?}") };
        for Record { name, entity, advert, .. } in &records {
            let said = advert.claims_unverified()?;
            let role = NameRole::of(said.op).context("a statement that is listed")?;
            serials.insert((*name, role, entity.name()?), said.serial);
        }
    }
    Ok(serials)
}

/// Returns the data frames that the middle switch forwarded in its kernel.
fn forwarded(replicas: &Replicas) -> Result<u64> {
    let status = replicas.ctl(FIRST_LEADER, &["status"])?;
    Ok(status["counters_by_plane"]["forwarded"]["kernel"].as_u64().unwrap_or(0))
}
