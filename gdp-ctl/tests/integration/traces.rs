//! Answers of a border to another domain that traces names through it, and its handling of missing
//! or invalid answers from the other domain.

use std::sync::Arc;

use crate::member::{Domain, LONG, Place};
use crate::switch::wait;
use gdp_core::domain::Credentials;
use gdp_core::identity::Identity;
use gdp_daemon::serve::Running;
use gdp_link::link::{Link, LinkIds};
use gdp_link::port::{LinkAddr, Port, PortConfig};
use gdp_proto::admin;
use gdp_proto::admin::trace::BeyondReply;
use gdp_proto::control::{Crossing, Refusal, RefusalCode, Request, Response, TraceLeg, TraceOn, TracedDomain};
use gdp_wire::Name;
use serde_json::Value;

#[tokio::test(flavor = "multi_thread")]
async fn another_domain_learns_nothing_of_names_that_it_sends_nothing_to_and_may_ask_so_often() {
    let f = Borders::start().await;
    let ask = async |leg, path: Vec<Name>| {
        let request = TraceOn { leg, name: Name::from_bytes([7; 32]), path, within_ms: 1000 };
        match f.link.request(&Request::TraceOn(request)).await.unwrap() {
            Response::Refused(Refusal { code, .. }) => code,
            other => panic!("{other:?}"),
        }
    };
    let (home, away) = (f.home.identity.name(), f.away.identity.name());
    assert_eq!(ask(TraceLeg::Across, vec![away]).await, RefusalCode::NotFound);
    assert_eq!(ask(TraceLeg::Across, vec![home, away]).await, RefusalCode::Malformed, "a loop");
    assert_eq!(ask(TraceLeg::Across, vec![]).await, RefusalCode::Malformed);
    let leg = TraceLeg::Out { domain: away, peer: f.border.name() };
    assert_eq!(ask(leg, vec![away]).await, RefusalCode::Malformed, "switches of the domain say that");
    let onward = Request::TraceOn(TraceOn { leg, name: home, path: vec![home], within_ms: 1000 });
    let onward = Request::Onward { to: f.running.name(), hops: 9, request: Box::new(onward) };
    assert!(matches!(f.link.request(&onward).await.unwrap(), Response::Refused(_)), "and none of another");

    let mut limited = 0;
    while limited == 0 {
        limited += u64::from(ask(TraceLeg::Across, vec![away]).await == RefusalCode::Limit);
    }
    let link = f.status().await.unwrap();
    assert_eq!(link["traces_refused"], limited, "{link}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_border_that_does_not_answer_or_answers_nonsense_is_said_to() {
    let f = Borders::start().await;
    let silent = f.trace().await;
    assert_eq!((&silent["outcome"], &silent["switch"]), (&"unanswered".into(), &f.border.name().to_string().into()));
    assert_eq!((&silent["domain"], &silent["rtt_us"]), (&f.away.identity.name().to_string().into(), &Value::Null));

    let link = f.link.clone();
    let (home, running) = (f.home.identity.name(), f.running.name());
    let answers = tokio::spawn(async move {
        while let Some((request, responder)) = link.accept_request().await {
            let Request::TraceOn(request) = request else { continue };
            // The request before it has timed out.
            if request.name != Name::from_bytes([7; 32]) || request.path != [home] {
                panic!("{request:?}");
            }
            let crossing = Crossing::Unanswered;
            let said = TracedDomain { depth: 2, domain: home, entry: running, rtt_us: None, crossing };
            let _ = responder.respond(Response::TracedOn { domains: vec![said] }).await;
        }
    });
    let nonsense = f.trace().await;
    assert_eq!(nonsense["outcome"], "refused", "{nonsense}");
    assert!(nonsense["reason"].as_str().unwrap().contains("makes no sense"), "{nonsense}");
    answers.abort();
}

/// A domain of two switches, and a border of another domain that the test simulates.
struct Borders {
    home: Domain,
    away: Domain,
    inner: Place,
    _inner_running: Running,
    /// The daemon of the first domain's border.
    running: Running,
    border: Identity,
    link: Link,
    _port: Port,
}

impl Borders {
    async fn start() -> Self {
        let (home, away) = (Domain::new(1), Domain::new(2));
        let place = Place::new("border");
        let peering = home.peer(&away, "peering", LONG);
        let running = place.member(&home, "border", LONG).peers(&[&peering]).rib().start().await;
        let inner = Place::new("inner");
        let inner_running = inner.member(&home, "switch", LONG).dials(&place).start().await;
        wait("the inner switch to see the border", async || inner_running.status().await["control"]["ready"] == true)
            .await;
        let border = Identity::generate("switch").unwrap();
        let membership = away.admit(border.name(), "border", LONG);
        let config = PortConfig::switch(border.clone(), LinkIds::new());
        config.credentials.set(Arc::new(Credentials { membership, peers: vec![away.peer(&home, "peering", LONG)] }));
        let port = Port::udp("127.0.0.1:0".parse().unwrap(), &config).unwrap();
        let link = port.dial(LinkAddr::udp(place.addr), Some(place.name)).await.unwrap();
        let borders = Self { home, away, inner, _inner_running: inner_running, running, border, link, _port: port };
        wait("the link", async || borders.status().await.is_some()).await;
        borders
    }

    /// Returns the daemon's status of the link.
    async fn status(&self) -> Option<Value> {
        let status = self.running.status().await;
        status["links"].as_array()?.iter().find(|link| link["relationship"] == "border").cloned()
    }

    /// Returns the inner switch's trace of the name beyond the link.
    async fn trace(&self) -> Value {
        let (domain, peer) = (self.away.identity.name(), self.border.name());
        let request =
            admin::Request::Beyond { name: Name::from_bytes([7; 32]), border: self.running.name(), domain, peer };
        let socket = self.inner.file("switch.sock");
        let asked = move || gdp_ctl::client::Client::connect(&socket).unwrap().ask(&request).unwrap();
        let BeyondReply { domains } = tokio::task::spawn_blocking(asked).await.unwrap();
        assert_eq!(domains.len(), 1, "{domains:?}");
        serde_json::to_value(&domains[0]).unwrap()
    }
}
