//! A switch with a RIB simulated by the test behind the switch's only neighbour. The tests cover
//! which RIB the switch obeys when several claim to lead, and how it executes the RIB's requests.

use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use gdp_core::cert::{LinkState, issue};
use gdp_core::identity::Identity;
use gdp_daemon::config::{Config, Neighbour, NeighbourAddress, Via};
use gdp_daemon::serve::{Running, start};
use gdp_link::link::{Link, LinkIds};
use gdp_link::port::{LinkAddr, Port, PortConfig};
use gdp_proto::control::{
    Extent, FibPush, Flooded, MAX_HOPS, NameRole, Peers, PeersExtent, PeersPush, RefusalCode, Request, Response, Route,
};
use gdp_wire::Name;
use tempfile::TempDir;
use tokio::time::timeout;

use crate::switch::{TIMEOUT, config, wait};

#[tokio::test(flavor = "multi_thread")]
async fn a_leader_of_yesterday_is_refused_once_another_has_said_something() {
    let rib = Rib::beside_a_switch(7).await;
    rib.takes(rib.fib(7, 1, WHOLE)).await;
    rib.takes(rib.fib(9, 1, WHOLE)).await;
    // The switch learns of another leader when it asks.
    rib.run.store(9, Ordering::Relaxed);
    rib.refuses(rib.fib(7, 2, Extent::Delta)).await;
    rib.refuses(rib.fib(7, 3, WHOLE)).await;
    rib.refuses(rib.peers(7)).await;
    rib.refuses(Request::Peerings { run: 7, wanted: vec![] }).await;
    assert_eq!(rib.switch.status().await["control"]["fenced"], 4);
    wait("the switch to ask who it is", async || rib.reports.load(Ordering::Relaxed) >= 2).await;
    rib.takes(rib.fib(9, 2, Extent::Delta)).await;
    assert_eq!(rib.switch.status().await["fib"]["generation"], 2);
    rib.switch.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_switch_follows_a_rib_whose_runs_begin_anew() {
    let rib = Rib::beside_a_switch(1 << 60).await;
    rib.takes(rib.fib(1 << 60, 8, WHOLE)).await;
    rib.run.store(5, Ordering::Relaxed);
    rib.refuses(rib.fib(5, 1, WHOLE)).await;
    let request = Request::Detach { switch: rib.switch.name(), entity: rib.switch.name() };
    assert!(matches!(rib.say(request).await, Response::Done), "it is to report");
    wait("the report", async || rib.switch.status().await["control"]["ready"] == true).await;
    rib.takes(rib.fib(5, 2, WHOLE)).await;
    rib.takes(rib.fib(5, 3, Extent::Delta)).await;
    rib.switch.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wanted_peering_is_made_at_the_address_that_answers() {
    let rib = Rib::beside_a_switch(7).await;
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let border = Identity::generate("switch").unwrap();
    let port = Port::udp("127.0.0.1:0".parse().unwrap(), &PortConfig::switch(border.clone(), LinkIds::new())).unwrap();
    let addrs = vec![silent.local_addr().unwrap(), port.udp_addr().unwrap()];
    rib.takes(Request::Peerings { run: 7, wanted: vec![(border.name(), addrs)] }).await;
    let link = timeout(TIMEOUT, port.accept()).await.expect("it is dialled").unwrap().unwrap();
    assert_eq!(link.peer().name, rib.switch.name());
    rib.switch.stop().await;
}

const WHOLE: Extent = Extent::Full { part: 0, last: true };

/// A simulated RIB, and its switch.
struct Rib {
    switch: Running,
    link: Link,
    /// Run number of the leader that accepts reports.
    run: Arc<AtomicU64>,
    reports: Arc<AtomicU64>,
    _port: Port,
    _folder: TempDir,
}

impl Rib {
    /// Starts a RIB and a switch, and waits until the RIB has received the switch's first report.
    async fn beside_a_switch(run: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let near = Identity::generate("switch").unwrap();
        let place = NeighbourAddress { switch: near.name(), via: Via::Udp("127.0.0.1:9".parse().unwrap()) };
        let neighbours = vec![Neighbour { address: place, cost: None, dial: false, parent: false, tls: None }];
        let config = Config { rib: false, neighbours, ..config(folder.path(), "s1") };
        let switch = start(config).await.unwrap();
        let to = LinkAddr::udp(switch.udp_addr().unwrap());
        let own = PortConfig::switch(near.clone(), LinkIds::new());
        let port = Port::udp("127.0.0.1:0".parse().unwrap(), &own).unwrap();
        let link = port.dial(to, Some(switch.name())).await.unwrap();
        let (run, reports) = (Arc::new(AtomicU64::new(run)), Arc::new(AtomicU64::new(0)));
        tokio::spawn(answer(link.clone(), run.clone(), reports.clone()));
        let rib = Self { switch, link, run, reports, _port: port, _folder: folder };
        let claims = LinkState {
            switch: near.name(),
            run: 1,
            number: 1,
            bit: None,
            neighbours: vec![(rib.switch.name(), 1)],
            silent: 0,
            rib: true,
            borders: vec![],
            lifetime: 60,
        };
        let state = issue(near.key(), &claims).unwrap();
        let states = vec![Flooded { proof: near.proof(), state, expires_in: 60 }];
        assert!(matches!(rib.link.request(&Request::Flood { states }).await.unwrap(), Response::Done));
        wait("the first report", async || rib.switch.status().await["control"]["ready"] == true).await;
        rib
    }

    async fn say(&self, request: Request) -> Response {
        let request = Request::Onward { to: self.switch.name(), hops: MAX_HOPS, request: Box::new(request) };
        self.link.request(&request).await.unwrap()
    }

    async fn takes(&self, request: Request) {
        let response = self.say(request).await;
        assert!(matches!(response, Response::Done), "{response:?}");
    }

    async fn refuses(&self, request: Request) {
        let response = self.say(request).await;
        let is_fenced = matches!(&response, Response::Refused(refusal) if refusal.code == RefusalCode::Fenced);
        assert!(is_fenced, "{response:?}");
    }

    fn fib(&self, run: u64, generation: u64, extent: Extent) -> Request {
        let set = vec![Route { name: Name::from_bytes([1; 32]), egress_bits: generation, ..Route::default() }];
        let switch = self.switch.name();
        Request::Fib(FibPush { switch, run, settling: false, generation, extent, own_bit: 0, set, remove: vec![] })
    }

    fn peers(&self, run: u64) -> Request {
        let (records, departed, boxes) = Default::default();
        let extent = PeersExtent::Whole { part: 0, last: true };
        let peers = Peers { run, settling: false, generation: 1, extent, records, departed, revocation: None, boxes };
        let (entity, name) = (Name::from_bytes([2; 32]), Name::from_bytes([1; 32]));
        Request::Peers(PeersPush { switch: self.switch.name(), entity, name, role: NameRole::Subscriber, peers })
    }
}

/// Answers requests like the neighbour with the RIB.
async fn answer(link: Link, run: Arc<AtomicU64>, reports: Arc<AtomicU64>) {
    while let Some((request, responder)) = link.accept_request().await {
        let is_report =
            matches!(&request, Request::Onward { request, .. } if matches!(**request, Request::Report { .. }));
        let response = match is_report {
            true => {
                reports.fetch_add(1, Ordering::Relaxed);
                Response::Reported { run: run.load(Ordering::Relaxed) }
            }
            false => Response::Done,
        };
        let _ = responder.respond(response).await;
    }
}
