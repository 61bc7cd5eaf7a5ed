//! What `top` asks for, once a second: the status of the switch, of the proxy, and the robots.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use gdp_core::name::NamePrefix;
use gdp_proto::admin::Request;
use gdp_proto::admin::proxy::ProxyReply;
use gdp_proto::admin::status::StatusReply;
use gdp_proto::admin::trace::LocateReply;
use gdp_wire::Name;

use crate::cli::context::Context;
use crate::cli::home::{HomeOptions, robots_of};
use crate::client::{Client, ProgramStatus};

/// The maximum number of names that are located. Others have no path.
const MAX_LOCATED: usize = 64;

/// How often robots are looked up, in files and at the RIB.
const ROBOTS: Duration = Duration::from_secs(5);

/// The state at one moment.
#[derive(Clone, Debug)]
pub struct TopSample {
    pub at: Instant,
    pub switch: Option<Box<StatusReply>>,
    pub proxy: Option<Box<ProxyReply>>,
    /// The next switches of the names that the proxy carries.
    pub paths: BTreeMap<Name, String>,
    pub robots: Vec<RobotState>,
    /// Why there is nothing to show.
    pub problem: Option<String>,
}

/// A robot, server or laptop of the domain.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotState {
    pub label: String,
    pub state: String,
    pub expose: String,
}

impl TopSample {
    /// A moment in which nobody answered.
    pub fn failed(error: &anyhow::Error) -> Self {
        let problem = Some(format!("{error:#}"));
        Self { at: Instant::now(), switch: None, proxy: None, paths: BTreeMap::new(), robots: Vec::new(), problem }
    }
}

/// Where the state comes from.
pub struct Sources<'a> {
    context: &'a Context,
    proxy_socket: Option<PathBuf>,
    home: &'a HomeOptions,
    robots: Vec<RobotState>,
    robots_at: Option<Instant>,
}

impl<'a> Sources<'a> {
    pub fn new(context: &'a Context, proxy_socket: Option<PathBuf>, home: &'a HomeOptions) -> Self {
        Self { context, proxy_socket, home, robots: Vec::new(), robots_at: None }
    }

    /// Asks both programs. Fails if neither answers.
    pub fn sample(&mut self) -> anyhow::Result<TopSample> {
        let mut sample = TopSample {
            at: Instant::now(),
            switch: None,
            proxy: None,
            paths: BTreeMap::new(),
            robots: Vec::new(),
            problem: None,
        };
        let asked = self.context.client().and_then(|mut client| Ok((client.status()?, client)));
        let mut daemon = None;
        let no_switch = match asked {
            Ok((ProgramStatus::Switch(status), client)) => {
                (sample.switch, daemon) = (Some(status), Some(client));
                None
            }
            Ok((ProgramStatus::Proxy(status), _)) => {
                sample.proxy = Some(status);
                None
            }
            Err(error) => Some(error),
        };
        if sample.proxy.is_none() {
            let asked = self.context.proxy(self.proxy_socket.as_deref()).and_then(|mut client| Ok(client.status()?));
            match (asked, no_switch) {
                (Ok(ProgramStatus::Proxy(status)), _) => sample.proxy = Some(status),
                // Nobody answers: the error of the daemon names what to start.
                (_, Some(error)) => return Err(error),
                (_, None) => {}
            }
        }
        if let (Some(client), Some(proxy)) = (&mut daemon, &sample.proxy) {
            sample.paths = paths(client, proxy);
        }
        sample.robots = self.robots();
        Ok(sample)
    }

    fn robots(&mut self) -> Vec<RobotState> {
        if self.robots_at.is_none_or(|at| at.elapsed() >= ROBOTS) {
            self.robots_at = Some(Instant::now());
            // Most machines have no files of the domain.
            let found = robots_of(self.home, self.context).ok().flatten();
            let members = found.map(|robots| robots.members).unwrap_or_default();
            let robot = members.into_iter().map(|member| RobotState {
                label: member.label,
                state: member.state.into(),
                expose: member.expose.join(" "),
            });
            self.robots = robot.collect();
        }
        self.robots.clone()
    }
}

/// Asks the switch where the names of the proxy's busiest topics are.
fn paths(client: &mut Client, proxy: &ProxyReply) -> BTreeMap<Name, String> {
    let mut topics: Vec<_> = proxy.topics.iter().collect();
    topics.sort_by_key(|topic| std::cmp::Reverse(topic.messages));
    let locate = |name: Name| {
        let found: LocateReply = client.ask(&Request::Locate { what: NamePrefix::from(name) }).ok()?;
        let egress = found.egress.iter().filter(|switch| **switch != found.own).map(|switch| format!("{switch:#}"));
        let path: Vec<String> = found.near.then(|| "here".to_owned()).into_iter().chain(egress).collect();
        (!path.is_empty()).then(|| (name, path.join(",")))
    };
    topics.iter().map(|topic| topic.name).take(MAX_LOCATED).filter_map(locate).collect()
}
