//! `gdp-ctl robots`: the members of the domain by label.

use std::collections::{BTreeMap, BTreeSet};

use clap::Args;
use gdp_core::cert::TopicsOf;
use gdp_core::name::NamePrefix;
use gdp_directory::fingerprint;
use gdp_directory::messages::Application;
use gdp_directory::service::MemberRow;
use gdp_util::date::rounded;
use gdp_util::unix_time::unix_seconds;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::renewals::is_of_server;
use super::{HomeOptions, members};
use crate::cli::context::Context;
use crate::cli::domain::{Issue, To};
use crate::cli::{output, query};

#[derive(Debug, Args)]
pub struct Options {
    #[command(flatten)]
    home: HomeOptions,
}

/// Output of `gdp-ctl robots`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct RobotsOutput {
    pub members: Vec<MemberOutput>,
}

/// A member, or whoever is invited as one.
#[derive(Debug, Serialize, JsonSchema)]
pub struct MemberOutput {
    pub label: String,
    /// `online`, `offline`, `joined` if no daemon tells whether it is online, `invited`, `pending`,
    /// `left`, `expired` or `revoked`.
    pub state: &'static str,
    /// None if it has not joined.
    entity: Option<Name>,
    /// Of a machine that waits for approval: what it shows, to be compared.
    fingerprint: Option<String>,
    pub expose: Vec<String>,
    /// Each with the label of the other member.
    import: Vec<String>,
    read: Vec<String>,
    /// End of the membership, in Unix seconds.
    until: u64,
    /// Time until which the join service renews the membership, in Unix seconds.
    renews_until: u64,
}

/// Returns the members of the domain whose files are on this machine.
pub fn gather(options: &HomeOptions, context: &Context) -> anyhow::Result<RobotsOutput> {
    let home = options.home()?;
    let ledger = home.ledger()?;
    let now = unix_seconds();
    let service = members::stored(&home)?;
    let joined: BTreeMap<u64, MemberRow> =
        service.rows(now).into_iter().map(|row| (row.enrollment.member, row)).collect();
    let online = online(&joined, context);
    let of = |rules: &[TopicsOf]| -> Vec<String> { rules.iter().map(ToString::to_string).collect() };
    let labels: BTreeSet<&str> = joined.values().map(|row| row.enrollment.label.as_str()).collect();
    let is_member = |issue: &&Issue| {
        let (To::Invited { role } | To::Member { role, .. }, Some(label)) = (&issue.to, &issue.label) else {
            return false;
        };
        // Not what a later certificate of the same member replaced.
        let is_replaced = labels.contains(label.as_str()) && !joined.contains_key(&issue.serial);
        !is_of_server(role) && !is_replaced
    };
    let member = |issue: &Issue| {
        let row = joined.get(&issue.serial);
        let state = match (row, &online) {
            _ if issue.is_revoked(ledger.revocation.as_ref()) => "revoked",
            _ if service.has_left(issue.serial) => "left",
            (Some(row), Some(online)) if online.contains(&row.entity) => "online",
            (Some(_), Some(_)) => "offline",
            (Some(_), None) => "joined",
            (None, _) if now > issue.not_after => "expired",
            (None, _) => "invited",
        };
        MemberOutput {
            label: issue.label.clone().unwrap_or_default(),
            state,
            entity: row.map(|row| row.entity),
            fingerprint: None,
            expose: row.map_or_else(Vec::new, |row| row.enrollment.expose.clone()),
            import: row.map_or_else(Vec::new, |row| of(&row.enrollment.import)),
            read: row.map_or_else(Vec::new, |row| of(&row.enrollment.read)),
            until: row.map_or(issue.ends, |row| row.until),
            renews_until: issue.ends,
        }
    };
    let decisions = home.decisions()?;
    let waiting = home.applications()?.into_iter().filter(|(entity, _)| !decisions.contains_key(entity));
    let waiting = waiting.map(|(entity, Application { label, expose, import, read, .. })| MemberOutput {
        label,
        state: "pending",
        entity: Some(entity),
        fingerprint: Some(fingerprint(entity)),
        expose,
        import: of(&import),
        read: of(&read),
        until: 0,
        renews_until: 0,
    });
    let members = ledger.issued.iter().filter(is_member).map(member).chain(waiting).collect();
    Ok(RobotsOutput { members })
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let (now, output) = (unix_seconds(), gather(&options.home, context)?);
    context.output.print(&output, || {
        let row = |member: &MemberOutput| {
            let entity = member.entity.map_or("–".to_owned(), |entity| format!("{entity:#}"));
            let entity = member.fingerprint.clone().unwrap_or(entity);
            let ends = match member.until {
                0 => format!("gdp-ctl approve {}", member.label),
                until if until < member.renews_until => format!("{}, renews", rounded(until.saturating_sub(now))),
                until => rounded(until.saturating_sub(now)),
            };
            let lists = [&member.expose, &member.import, &member.read];
            let [expose, import, read] =
                lists.map(|list| if list.is_empty() { "–".to_owned() } else { list.join(" ") });
            [member.label.clone(), member.state.to_owned(), entity, expose, import, read, ends]
        };
        let rows: Vec<_> = output.members.iter().map(row).collect();
        output::table(["label", "state", "entity", "exposes", "imports", "reads", "ends in"], &rows)
    })
}

/// Returns the entities that publish their catalog now. `None` if no daemon answers.
fn online(joined: &BTreeMap<u64, MemberRow>, context: &Context) -> Option<BTreeSet<Name>> {
    let mut client = context.client().ok()?;
    let mut online = BTreeSet::new();
    for catalog in joined.values().filter_map(|row| row.catalog) {
        let (records, _) = query::ask(&mut client, &NamePrefix::from(catalog)).ok()?;
        online.extend(records.iter().filter_map(|record| record.entity.name().ok()));
    }
    Some(online)
}
