//! The metrics of a join service: its members and applicants by state, and what it replied.

use std::collections::BTreeMap;
use std::sync::Arc;

use gdp_directory::directory::Directory;
use gdp_directory::messages::JoinReply;
use gdp_http::metrics::{Exposition, PATH};
use gdp_http::{HttpResponse, Listener};
use parking_lot::Mutex;

gdp_http::metrics! {
    BUILD: gauge "gdp_join_build_info" ["version"] "Always 1; the label has the release";
    MEMBERS: gauge "gdp_join_members" ["state"] "Machines by state: joined, or pending, which wait for approval";
    EXPIRY: gauge "gdp_join_first_membership_expiry_timestamp_seconds" [] "When the first membership ends, if it is not renewed";
    REPLIES: counter "gdp_join_replies" ["outcome"] "Replies to machines: joined, pending, approved, left or refused";
    FAILED_WRITES: counter "gdp_join_failed_writes" [] "Changes that could not be stored, so that they were refused";
}

/// What a scrape shows. The service updates it after each change.
#[derive(Clone, Default)]
pub struct JoinMetrics(Arc<Mutex<Figures>>);

#[derive(Default)]
struct Figures {
    joined: u64,
    pending: u64,
    first_end: Option<u64>,
    replies: BTreeMap<&'static str, u64>,
    failed_writes: u64,
}

impl JoinMetrics {
    /// Takes the members of a directory, and the number of machines that wait for approval.
    pub fn update(&self, directory: &Directory, pending: usize) {
        let ends = directory.entries.iter().map(|entry| entry.membership.until_unverified().unwrap_or_default());
        let figures = &mut *self.0.lock();
        (figures.joined, figures.pending) = (directory.entries.len() as u64, pending as u64);
        figures.first_end = ends.min();
    }

    pub fn replied(&self, reply: &JoinReply) {
        let outcome = match reply {
            JoinReply::Joined { .. } => "joined",
            JoinReply::Pending => "pending",
            JoinReply::Approved(_) => "approved",
            JoinReply::Left => "left",
            JoinReply::Refused(_) => "refused",
        };
        *self.0.lock().replies.entry(outcome).or_default() += 1;
    }

    pub fn write_failed(&self) {
        self.0.lock().failed_writes += 1;
    }

    fn exposition(&self) -> Exposition {
        let (figures, mut all) = (self.0.lock(), Exposition::default());
        all.add(&BUILD, [env!("CARGO_PKG_VERSION")], 1);
        all.add(&MEMBERS, ["joined"], figures.joined);
        all.add(&MEMBERS, ["pending"], figures.pending);
        figures.first_end.iter().for_each(|end| all.add(&EXPIRY, [], *end));
        figures.replies.iter().for_each(|(outcome, count)| all.add(&REPLIES, [outcome], *count));
        all.add(&FAILED_WRITES, [], figures.failed_writes);
        all
    }

    /// Answers scrapes. Never ends.
    pub async fn serve(self, listener: Listener) {
        gdp_http::serve(listener, move |request| {
            let metrics = self.clone();
            async move {
                match request.path == PATH {
                    true => metrics.exposition().response(&request),
                    false => HttpResponse::not_found(),
                }
            }
        })
        .await;
    }
}

#[cfg(test)]
#[path = "../../../tests/unit/cli/join_metrics.rs"]
mod tests;
