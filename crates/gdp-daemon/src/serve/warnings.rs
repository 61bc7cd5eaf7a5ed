//! The warnings of `gdp-ctl status`: suspicious states without a failure. They may be intended. A
//! publisher may have no data, and a subscriber may be early.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use gdp_core::peer::Role;
use gdp_proto::admin::status::Warning;
use gdp_wire::{Counter, Name};

use super::core::Core;
use super::interfaces::SmallMtu;

/// The time without a frame after which an endpoint counts as silent. A subscriber sends greetings
/// to its publishers more often.
const SILENT: Duration = Duration::from_secs(10);

/// The maximum number of names in one warning.
const NAMES: usize = 10;

pub fn warnings(core: &Core) -> Vec<Warning> {
    let open = core.membership.is_open.then_some(Warning::Open);
    let small = core.switch.small_mtus.iter().map(|(interface, small)| {
        let (interface, SmallMtu { mtu, needed }) = (interface.clone(), *small);
        Warning::SmallMtu { interface, mtu, needed }
    });
    small.chain(open).chain(silent(core)).chain(without_publisher(core)).collect()
}

/// Returns the endpoints that may send to names with receivers, but sent no accepted frame on any
/// current link. The counters are exact, but per link. Frames are not counted by name.
fn silent(core: &Core) -> Vec<Warning> {
    let mut quiet = BTreeMap::<Name, Duration>::new();
    let mut heard = BTreeSet::new();
    for (id, state) in core.switch.links.iter().filter(|(_, state)| state.link.peer().role == Role::Endpoint) {
        let (peer, age) = (state.link.peer().name, state.since.elapsed());
        let came = core.switch.planes.arrivals(*id).map_or(true, |row| {
            [Counter::Forwarded, Counter::Delivered, Counter::Replicated].iter().any(|c| row[*c as usize] > 0)
        });
        if came || age < SILENT {
            heard.insert(peer);
        } else {
            quiet.entry(peer).and_modify(|longest| *longest = age.max(*longest)).or_insert(age);
        }
    }
    quiet.retain(|peer, _| !heard.contains(peer));
    let warn = |(entity, age): (Name, Duration)| {
        let names = core.switch.routes.leading_from(&entity);
        (names > 0).then_some(Warning::Silent { entity, names, for_s: age.as_secs() })
    };
    quiet.into_iter().filter_map(warn).collect()
}

/// Returns the names with subscribers or clients, but without a publisher or server. Uses what the
/// local RIB knows.
fn without_publisher(core: &Core) -> Option<Warning> {
    let (count, names) = core.rib_host.rib.as_ref()?.without_publisher();
    (count > 0).then(|| Warning::NotServed { count, names: names.take(NAMES).collect() })
}
