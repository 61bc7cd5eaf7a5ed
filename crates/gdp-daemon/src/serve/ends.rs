//! The links to one peer in the data plane.
//!
//! An endpoint may have several links at once, each on its own lane. Each lane has its newest link,
//! and earlier ones on which the peer may still send. This module only tracks link ids.
//! [`super::routes`] asks it which link to send on. The switch in [`super::core`] and
//! [`super::graceful_restart`] decide how long links last.

use std::cmp::Reverse;
use std::collections::BTreeMap;

/// The links to a peer. An absent peer has none.
#[derive(Debug, Default)]
pub struct Ends {
    lanes: BTreeMap<u8, Lane>,
    /// The lane that the peer prefers for frames that go over only one of its links.
    preferred: Option<u8>,
}

impl Ends {
    /// Returns the link to send on. Prefers a lane whose newest link is ready, then the peer's
    /// preferred lane, then the lowest lane.
    pub fn out(&self) -> Option<u32> {
        let in_use = self.lanes.iter().filter_map(|(number, lane)| Some((number, lane, lane.out()?)));
        let rank = |(number, lane, _): &(&u8, &Lane, u32)| {
            (Reverse(lane.is_ready()), Reverse(self.preferred == Some(**number)), **number)
        };
        in_use.min_by_key(rank).map(|(.., link)| link)
    }

    /// Returns the link to send on of each lane.
    pub fn each(&self) -> impl Iterator<Item = u32> {
        self.lanes.values().filter_map(Lane::out)
    }

    /// Returns all links on which frames of the peer may arrive.
    pub fn all(&self) -> impl Iterator<Item = u32> {
        self.lanes.values().flat_map(Lane::all)
    }

    pub fn is_empty(&self) -> bool {
        self.lanes.is_empty()
    }

    /// Returns whether a newer link has replaced the link.
    pub fn is_earlier(&self, link: u32) -> bool {
        self.lanes.values().any(|lane| lane.is_earlier(link))
    }

    /// Adds a link of an earlier daemon. The last one added is the one to send on for its lane.
    pub fn adopt(&mut self, lane: u8, link: u32) {
        self.lanes.entry(lane).or_default().adopt(link);
    }

    /// Adds a new link. The link that its lane sent on becomes an earlier one.
    pub fn up(&mut self, lane: u8, link: u32) {
        self.lanes.entry(lane).or_default().up(link);
    }

    /// Marks a link as ready: the peer accepts frames on it.
    pub fn ready(&mut self, link: u32) {
        self.lanes.values_mut().for_each(|lane| lane.ready(link));
    }

    /// Makes the link's lane the preferred one. A link that is gone changes nothing.
    pub fn prefer(&mut self, link: u32) {
        let lane = self.lanes.iter().find(|(_, lane)| lane.all().any(|of| of == link));
        self.preferred = lane.map(|(number, _)| *number).or(self.preferred);
    }

    /// Handles a silent link. Returns whether to keep it as an earlier link. The newest link is
    /// kept if it is the one to send on.
    pub fn silent(&mut self, link: u32) -> bool {
        let silent = self.lanes.values_mut().any(|lane| lane.silent(link));
        self.lanes.retain(|_, lane| !lane.is_empty());
        silent
    }

    /// Removes a link. Returns the earlier links of its lane that end with it: all, if it was the
    /// newest and ready.
    pub fn removed(&mut self, link: u32) -> Vec<u32> {
        let with_it = self.lanes.values_mut().flat_map(|lane| lane.removed(link)).collect();
        self.lanes.retain(|_, lane| !lane.is_empty());
        with_it
    }
}

/// The links of one lane.
#[derive(Debug, Default)]
struct Lane {
    newest: Option<Newest>,
    /// The earlier links. The last one is the one most recently sent on.
    earlier: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Newest {
    link: u32,
    /// Whether the peer accepts frames on the link.
    ready: bool,
}

impl Lane {
    /// Returns the link to send on: the newest once it is ready, and the previous one until then.
    fn out(&self) -> Option<u32> {
        let before = self.earlier.last().copied();
        match self.newest {
            Some(newest) if newest.ready => Some(newest.link),
            newest => before.or(newest.map(|newest| newest.link)),
        }
    }

    /// Returns whether the newest link is ready.
    fn is_ready(&self) -> bool {
        self.newest.is_some_and(|newest| newest.ready)
    }

    /// Returns all links on which frames of the peer may arrive.
    fn all(&self) -> impl Iterator<Item = u32> {
        self.earlier.iter().copied().chain(self.newest.map(|newest| newest.link))
    }

    fn is_empty(&self) -> bool {
        self.newest.is_none() && self.earlier.is_empty()
    }

    fn is_earlier(&self, link: u32) -> bool {
        self.earlier.contains(&link)
    }

    fn adopt(&mut self, link: u32) {
        self.earlier.retain(|earlier| *earlier != link);
        self.earlier.push(link);
    }

    /// Adds a new link. The link to send on becomes an earlier one.
    fn up(&mut self, link: u32) {
        let sent_on = self.out();
        if let Some(old) = self.newest.replace(Newest { link, ready: false })
            && sent_on == Some(old.link)
        {
            self.earlier.push(old.link);
        }
    }

    /// Marks the link as ready, if it is the newest.
    fn ready(&mut self, link: u32) {
        if let Some(newest) = self.newest.as_mut().filter(|newest| newest.link == link) {
            newest.ready = true;
        }
    }

    /// Handles a silent link. Returns whether to keep it as an earlier link. The newest link is
    /// kept if it is the one to send on.
    fn silent(&mut self, link: u32) -> bool {
        let sent_on = self.out() == Some(link);
        if self.newest.take_if(|newest| newest.link == link).is_some() && sent_on {
            self.earlier.push(link);
        }
        self.is_earlier(link)
    }

    /// Removes a link. Returns the earlier links that end with it: all, if it was the newest and
    /// ready.
    fn removed(&mut self, link: u32) -> Vec<u32> {
        self.earlier.retain(|earlier| *earlier != link);
        let ended = self.newest.take_if(|newest| newest.link == link);
        if ended.is_some_and(|newest| newest.ready) { std::mem::take(&mut self.earlier) } else { Vec::new() }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/ends.rs"]
mod tests;
