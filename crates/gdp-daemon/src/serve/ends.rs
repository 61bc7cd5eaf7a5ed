//! The links to one peer in the data plane. An endpoint may have several at once, each a lane; of
//! each lane there is the newest link, and earlier ones that the peer may still send on. Pure
//! bookkeeping of ids; [`super::routes`] asks it which link to send on, the switch in
//! [`super::core`] and [`super::graceful_restart`] say how long links last.

use std::cmp::Reverse;
use std::collections::BTreeMap;

/// The links to a peer. None: the peer is not there.
#[derive(Debug, Default)]
pub struct Ends {
    lanes: BTreeMap<u8, Lane>,
    /// What goes once goes by this one, as the peer has said.
    preferred: Option<u8>,
}

impl Ends {
    /// The link to send on: of the lane that the peer prefers, or the first, of those that are in
    /// use.
    pub fn out(&self) -> Option<u32> {
        let in_use = self.lanes.iter().filter_map(|(number, lane)| Some((number, lane, lane.out()?)));
        let rank = |(number, lane, _): &(&u8, &Lane, u32)| {
            (Reverse(lane.is_ready()), Reverse(self.preferred == Some(**number)), **number)
        };
        in_use.min_by_key(rank).map(|(.., link)| link)
    }

    /// The link of each lane to send on.
    pub fn each(&self) -> impl Iterator<Item = u32> {
        self.lanes.values().filter_map(Lane::out)
    }

    /// All links that frames of the peer may come on.
    pub fn all(&self) -> impl Iterator<Item = u32> {
        self.lanes.values().flat_map(Lane::all)
    }

    pub fn is_empty(&self) -> bool {
        self.lanes.is_empty()
    }

    /// Whether the link is an earlier one.
    pub fn is_earlier(&self, link: u32) -> bool {
        self.lanes.values().any(|lane| lane.is_earlier(link))
    }

    /// A link from before this daemon; of its lane, the last one that is added is the one to send
    /// on.
    pub fn adopt(&mut self, lane: u8, link: u32) {
        self.lanes.entry(lane).or_default().adopt(link);
    }

    /// A new link is up. The one of its lane that was sent on becomes an earlier one.
    pub fn up(&mut self, lane: u8, link: u32) {
        self.lanes.entry(lane).or_default().up(link);
    }

    /// The peer takes frames on this link.
    pub fn ready(&mut self, link: u32) {
        self.lanes.values_mut().for_each(|lane| lane.ready(link));
    }

    /// The peer wants on this link what it wants on one. One that is gone by now changes nothing.
    pub fn prefer(&mut self, link: u32) {
        let lane = self.lanes.iter().find(|(_, lane)| lane.all().any(|of| of == link));
        self.preferred = lane.map(|(number, _)| *number).or(self.preferred);
    }

    /// The link fell silent. Whether it is worth keeping, as an earlier one: the newest is if it is
    /// the one that is sent on.
    pub fn silent(&mut self, link: u32) -> bool {
        let silent = self.lanes.values_mut().any(|lane| lane.silent(link));
        self.lanes.retain(|_, lane| !lane.is_empty());
        silent
    }

    /// The link is gone. Returns earlier ones of its lane that go with it: all, if it was ended
    /// while it was in use.
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
    /// The last is the one that was sent on last.
    earlier: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Newest {
    link: u32,
    /// Whether the peer has said that it takes frames on it.
    ready: bool,
}

impl Lane {
    /// The link to send on: the newest once the peer takes frames on it, and until then the one
    /// before.
    fn out(&self) -> Option<u32> {
        let before = self.earlier.last().copied();
        match self.newest {
            Some(newest) if newest.ready => Some(newest.link),
            newest => before.or(newest.map(|newest| newest.link)),
        }
    }

    /// Whether the peer takes frames on the newest.
    fn is_ready(&self) -> bool {
        self.newest.is_some_and(|newest| newest.ready)
    }

    /// All links that frames of the peer may come on.
    fn all(&self) -> impl Iterator<Item = u32> {
        self.earlier.iter().copied().chain(self.newest.map(|newest| newest.link))
    }

    fn is_empty(&self) -> bool {
        self.newest.is_none() && self.earlier.is_empty()
    }

    /// Whether the link is an earlier one.
    fn is_earlier(&self, link: u32) -> bool {
        self.earlier.contains(&link)
    }

    fn adopt(&mut self, link: u32) {
        self.earlier.retain(|earlier| *earlier != link);
        self.earlier.push(link);
    }

    /// A new link is up. The one that was sent on becomes an earlier one.
    fn up(&mut self, link: u32) {
        let sent_on = self.out();
        if let Some(old) = self.newest.replace(Newest { link, ready: false })
            && sent_on == Some(old.link)
        {
            self.earlier.push(old.link);
        }
    }

    /// The peer takes frames on this link.
    fn ready(&mut self, link: u32) {
        if let Some(newest) = self.newest.as_mut().filter(|newest| newest.link == link) {
            newest.ready = true;
        }
    }

    /// The link fell silent. Whether it is worth keeping, as an earlier one: the newest is if it is
    /// the one that is sent on.
    fn silent(&mut self, link: u32) -> bool {
        let sent_on = self.out() == Some(link);
        if self.newest.take_if(|newest| newest.link == link).is_some() && sent_on {
            self.earlier.push(link);
        }
        self.is_earlier(link)
    }

    /// The link is gone. Returns earlier ones that go with it: all, if it was ended while it was in
    /// use.
    fn removed(&mut self, link: u32) -> Vec<u32> {
        self.earlier.retain(|earlier| *earlier != link);
        let ended = self.newest.take_if(|newest| newest.link == link);
        if ended.is_some_and(|newest| newest.ready) { std::mem::take(&mut self.earlier) } else { Vec::new() }
    }
}

#[cfg(test)]
#[path = "../../tests/unit/serve/ends.rs"]
mod tests;
