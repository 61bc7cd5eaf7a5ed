//! The admin socket. Each line is one JSON object, in both directions; see [`gdp_proto::admin`].

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use futures::stream;
use gdp_proto::admin::error::{ErrorCode, ErrorReply};
use gdp_proto::admin::links::LinksReply;
use gdp_proto::admin::trace::{
    Beyond, BeyondReply, DomainHop, DomainInside, EchoReply, InsideHop, LocateReply, PathEnd, ProbeReply,
};
use gdp_proto::admin::words::Outcome;
use gdp_proto::control::{Crossing, RefusalCode, Response, TracedDomain, TracedEnd, TracedSwitch};
use gdp_util::line_socket::{self, Answer, Answering, Listening, SocketError, Unanswered};

use super::core::probes::Location;
use super::daemon::Daemon;
use super::entity_requests::{self, Origin};
use super::status;
use super::trace::Hop;
use gdp_proto::admin::{MAX_REQUEST, PAGE, Reply, Request, refusal_line, reply_line};

/// Opens the socket, and serves it until the daemon ends.
pub fn listen(daemon: &Arc<Daemon>, path: &Path) -> Result<Listening, SocketError> {
    let (listening, listener) = line_socket::listen(path)?;
    daemon.spawn(line_socket::serve(listener, Admin(daemon.clone())));
    Ok(listening)
}

struct Admin(Arc<Daemon>);

impl Answering for Admin {
    const MAX_LINE: usize = MAX_REQUEST;

    async fn answer(&self, line: Vec<u8>) -> Answer {
        let Self(daemon) = self;
        let reply = match gdp_proto::admin::parse_request(&line) {
            Ok(Request::Monitor) => {
                let listener = daemon.core().events.listen();
                let lines = stream::unfold(listener, async |mut listener| {
                    let event = listener.next().await?;
                    Some((reply_line(&Reply::Event(event)), listener))
                });
                return Answer::Watch { first: reply_line(&Reply::Monitoring), lines: Box::pin(lines) };
            }
            Ok(request) => answer(daemon, request).await,
            Err(reason) => malformed(&reason),
        };
        Answer::Line(reply_line(&reply))
    }

    fn refuse(&self, why: Unanswered) -> String {
        let code = if let Unanswered::TooLong(_) = why { RefusalCode::Malformed } else { RefusalCode::Limit };
        refusal_line(code, &why.to_string())
    }
}

async fn answer(daemon: &Arc<Daemon>, request: Request) -> Reply {
    match request {
        Request::Monitor => malformed("events have a connection of their own"),
        Request::Hello => status::hello(daemon).into(),
        Request::Status => Reply::Status(Box::new(status::status(daemon).await)),
        Request::Links => LinksReply { links: status::links(daemon, &daemon.core()) }.into(),
        Request::Peers => status::peers(&daemon.core()).into(),
        Request::Topology => status::topology(daemon).into(),
        Request::Fib { after } => or_failure(status::fib(daemon, after, PAGE)),
        Request::Rib { after } => or_failure(status::rib(daemon, after, PAGE)),
        Request::Locate { what } => {
            let core = daemon.core();
            or_failure(core.locate(&what).map(|Location { name, is_near, egress }| LocateReply {
                name,
                own: core.name(),
                near: is_near,
                egress,
                end: path_end(&core.switch.end_of(&name)),
            }))
        }
        Request::Echo { peer } => {
            or_failure(daemon.echo(peer).await.map(|time| EchoReply { rtt_us: time.map(micros) }))
        }
        Request::Probe { name, switch, hops } => {
            or_failure(daemon.probe(None, name, switch, hops).await.map(|hop| match hop {
                Some(Hop { switch, end, time }) => {
                    ProbeReply { switch: Some(switch), rtt_us: Some(micros(time)), end: end.as_ref().map(path_end) }
                }
                None => ProbeReply::default(),
            }))
        }
        Request::Beyond { name, border, domain, peer } => {
            let domains = daemon.trace_beyond(name, border, (domain, peer)).await;
            BeyondReply { domains: domains.into_iter().map(domain_hop).collect() }.into()
        }
        Request::Entity { entity, request } => {
            match entity_requests::answer(daemon, Origin::Tool(entity), *request).await {
                Response::Refused(refusal) => Reply::Error(refusal.into()),
                response => Reply::Control(response),
            }
        }
    }
}

fn path_end(end: &TracedEnd) -> PathEnd {
    let beyond = end.beyond.iter().map(|&(domain, switch)| Beyond { domain, switch });
    PathEnd { links: end.links, beyond: beyond.collect() }
}

fn domain_hop(TracedDomain { depth, domain, entry, rtt_us, crossing }: TracedDomain) -> DomainHop {
    let (outcome, reason, inside) = match crossing {
        Crossing::Traced { links, time_us, switches } => {
            let hop = |TracedSwitch { hop, switch, rtt_us }| InsideHop { hop, switch, rtt_us };
            let hops = switches.map(|switches| switches.into_iter().map(hop).collect());
            (Outcome::Traced, None, Some(DomainInside { links, rtt_us: time_us, hops }))
        }
        Crossing::Unanswered => (Outcome::Unanswered, None, None),
        Crossing::Refused { reason } => (Outcome::Refused, Some(reason), None),
        Crossing::Loop => (Outcome::Loop, None, None),
        Crossing::TooFar => (Outcome::TooFar, None, None),
    };
    DomainHop { depth, domain, switch: entry, rtt_us, outcome, reason, inside }
}

fn micros(time: Duration) -> u64 {
    time.as_micros() as u64
}

fn or_failure<R: Into<Reply>, E: ToString>(result: Result<R, E>) -> Reply {
    match result {
        Ok(reply) => reply.into(),
        Err(error) => Reply::Error(ErrorReply::new(ErrorCode::Failed, &error.to_string())),
    }
}

fn malformed(reason: &str) -> Reply {
    Reply::Error(ErrorReply::new(ErrorCode::Refused(RefusalCode::Malformed), reason))
}
