//! Queries for one name per second over a daemon's links. Daemon and clients share all CPUs. The
//! comparison is with as many requests on the same links that ask for nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use gdp_core::identity::Identity;
use gdp_daemon::config::Config;
use gdp_daemon::serve::{Running, start};
use gdp_link::link::Link;
use gdp_link::port::{LinkAddr, Port, PortConfig};
use gdp_proto::control::{EntityRequest, Request, Response};
use gdp_tests::measure::figure::{Aim, Figure, Unit};
use gdp_tests::measure::rounds::{Contender, Sample, alternate};

use crate::Bench;
use crate::owner::Owner;

/// Names in the RIB.
const NAMES: usize = 4096;

/// Links of clients, and requests in flight on each.
const LINKS: usize = 16;
const AT_ONCE: usize = 16;

const ENOUGH: f64 = 50_000.0;

const QUERY: &str = "query";
const NOTHING: &str = "nothing asked";

pub fn run(bench: &Bench) -> Result<Vec<Figure>> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let folder = tempfile::tempdir().context("cannot create a folder")?;
    let (daemon, clients, queries) = runtime.block_on(prepare(folder.path()))?;
    let ask = |requests: &[Request]| runtime.block_on(rate(&clients, requests, bench.duration()));
    let case = format!("{LINKS} links, {AT_ONCE} at once on each");
    let contenders =
        vec![Contender::new(QUERY, &case, || ask(&queries)), Contender::new(NOTHING, &case, || ask(&[Request::Ready]))];
    let measures = alternate(bench.rounds, contenders)?;
    runtime.block_on(daemon.stop());
    let title = "Requests answered over QUIC, daemon and clients on the same CPUs";
    let figure = Figure::new("control-queries", title, Unit::PerSecond, measures).compare(QUERY, NOTHING, |_| None);
    Ok(vec![figure.aim(QUERY, &case, Aim::AtLeast(ENOUGH))])
}

struct Client {
    link: Link,
    _port: Port,
}

async fn prepare(folder: &std::path::Path) -> Result<(Running, Vec<Client>, Vec<Request>)> {
    let daemon = start(Config {
        rib: true,
        fib_capacity: 1024,
        ..Config::userspace(folder.join("switch.pem"), "127.0.0.1:0".parse()?)
    })
    .await?;
    let (owner, to) = (Owner::new()?, daemon.udp_addr().context("no address")?);
    let dial = async |identity: Identity| {
        let port = Port::udp("127.0.0.1:0".parse()?, &PortConfig::endpoint(identity))?;
        let link = port.dial(LinkAddr::udp(to), Some(daemon.name())).await?;
        anyhow::Ok(Client { link, _port: port })
    };
    let robot = Identity::generate("proxy")?;
    let mut clients = vec![dial(robot.clone()).await?];
    let mut statements = vec![owner.attach(&robot, daemon.name(), false)?];
    for (serial, number) in (1..).zip(0..NAMES) {
        statements.push(owner.advertise(number, &robot, daemon.name(), serial, Vec::new())?);
    }
    for statement in statements {
        let response = clients[0].link.request(&Request::Entity(statement)).await?;
        ensure!(!matches!(response, Response::Refused(_)), "{response:?}");
    }
    for _ in 1..LINKS {
        clients.push(dial(Identity::generate("proxy")?).await?);
    }
    let query = |number: usize| {
        let prefix = owner.name(number).to_string().parse()?;
        anyhow::Ok(Request::Entity(EntityRequest::Query { prefix, after: None }))
    };
    // The names are far apart in sort order.
    let queries = (0..NAMES).map(query).collect::<Result<_>>()?;
    Ok((daemon, clients, queries))
}

async fn rate(clients: &[Client], requests: &[Request], duration: Duration) -> Result<Sample> {
    let (answered, begin) = (Arc::new(AtomicU64::new(0)), Instant::now());
    let mut tasks = tokio::task::JoinSet::new();
    for (i, client) in clients.iter().enumerate() {
        for j in 0..AT_ONCE {
            let (link, answered) = (client.link.clone(), answered.clone());
            let mut requests = requests.iter().cloned().cycle().skip((i * AT_ONCE + j) % requests.len()).step_by(7);
            let requests: Vec<Request> = requests.by_ref().take(64).collect();
            tasks.spawn(async move {
                for request in requests.iter().cycle() {
                    if begin.elapsed() >= duration {
                        return Ok(());
                    }
                    match link.request(request).await? {
                        Response::Records { records, .. } if records.is_empty() => bail!("a name is not known"),
                        Response::Refused(refusal) => bail!("refused: {refusal}"),
                        _ => _ = answered.fetch_add(1, Ordering::Relaxed),
                    }
                }
                Ok(())
            });
        }
    }
    while let Some(ended) = tasks.join_next().await {
        ended??;
    }
    Ok(Sample { value: answered.load(Ordering::Relaxed) as f64 / begin.elapsed().as_secs_f64(), ..Sample::default() })
}
