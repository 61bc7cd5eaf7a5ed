//! Shared parts of `gdp-ctl grant revoke` and `gdp-ctl domain revoke`: creating the next revocation
//! of a name, and publishing it.

use anyhow::{Context as _, bail};
use gdp_core::card::NameCard;
use gdp_core::cert::{MAX_REVOKED, Revocation, Signed, last_serial};
use gdp_proto::control::{EntityRequest, Response};
use gdp_util::terminal::note;
use gdp_wire::Name;
use schemars::JsonSchema;
use serde::Serialize;

use super::issuance_log::{Entry, IssuanceLog};
use crate::cli::context::Context;
use crate::cli::issuing::serial_now;
use crate::client::ClientError;
use gdp_proto::admin::Request;
use gdp_proto::admin::error::ErrorCode;
use gdp_proto::control::RefusalCode;

/// Number of seconds that an expired certificate stays listed, because a clock may be behind by
/// this much.
const CLOCKS_DIFFER: u64 = 86400;

/// Sends the newest revocation of the issuance log's name to the daemon, and prints the result.
/// `anew`: the revocation is new, so it is useful even if no daemon answers. `again`: the command
/// that publishes it later.
pub fn publish(
    issuance_log: &IssuanceLog,
    signed: Signed<Revocation>,
    claims: &Revocation,
    anew: bool,
    again: &str,
    context: &Context,
) -> anyhow::Result<()> {
    let file = issuance_log.revocation_path();
    let published = match send(issuance_log.card(), signed, context) {
        Ok(()) => true,
        // The revocation takes effect when the fabric receives it. This machine may be offline.
        Err(error) if anew && matches!(error.downcast_ref(), Some(ClientError::NoDaemon { .. })) => {
            note(format_args!(
                "gdp-ctl: not published, so it has no effect yet: {error}. Then, or on another machine with a copy \
                 of {} beside \
                 one of the card, run `{again}`",
                file.display()
            ));
            false
        }
        Err(error) => {
            let refused = error.downcast_ref().map(ClientError::code);
            let rolled_back = refused == Some(ErrorCode::Refused(RefusalCode::ReplayedSerial));
            let remedy = if rolled_back { "; if newer files have been lost, take all back with --all" } else { "" };
            return Err(error.context(format!("{} is kept, but not published{remedy}", file.display())));
        }
    };
    let revocation = RevocationOutput::new(claims);
    let output =
        RevokeOutput { revocation, name: issuance_log.card().name(), file: file.display().to_string(), published };
    context.output.print(&output, || {
        let told = if published { "published" } else { "not published" };
        [format!("revocation {} of {:#}, {told}: {}", claims.number, claims.name, file.display())]
    })
}

/// A revocation. Serials are text, because JavaScript and jq round such numbers.
#[derive(Debug, Serialize, JsonSchema)]
pub struct RevocationOutput {
    number: u64,
    /// All certificates with a lower serial are revoked.
    floor: String,
    /// Further revoked serials.
    revoked: Vec<String>,
}

impl RevocationOutput {
    pub fn new(revocation: &Revocation) -> Self {
        let revoked = revocation.revoked.iter().map(u64::to_string).collect();
        Self { number: revocation.number, floor: revocation.floor.to_string(), revoked }
    }
}

/// Output of `gdp-ctl grant revoke` and `gdp-ctl domain revoke`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct RevokeOutput {
    #[serde(flatten)]
    revocation: RevocationOutput,
    name: Name,
    file: String,
    /// Whether a RIB has received it.
    published: bool,
}

/// Returns the revocation that follows `known`. A new `floor` supersedes all earlier revocations,
/// so `known` may be lost. The number is then at least the time, which exceeds any earlier number.
/// Certificates in the ledger that a faulty clock dated above the floor are listed beside it.
pub fn next<E: Entry>(
    name: Name,
    known: Option<&Revocation>,
    issued: &[E],
    chosen: &[u64],
    floor: Option<u64>,
    now: u64,
) -> anyhow::Result<Revocation> {
    let number = known.map_or(0, |known| known.number).checked_add(1).context("the numbers are used up")?;
    let is_new_floor = floor.is_some();
    let (number, floor) = match floor {
        Some(floor) => (number.max(now), floor),
        None => (number, known.map_or(0, |known| known.floor)),
    };
    let over = |serial: &u64| {
        let entry = issued.iter().find(|entry| entry.serial() == *serial);
        *serial < floor || entry.is_some_and(|entry| entry.ends().saturating_add(CLOCKS_DIFFER) < now)
    };
    let mut revoked: Vec<u64> = known.map_or_else(Vec::new, |known| known.revoked.clone());
    revoked.retain(|serial| !over(serial));
    let dated_ahead = issued.iter().map(Entry::serial).filter(|_| is_new_floor);
    revoked.extend(chosen.iter().copied().chain(dated_ahead).filter(|serial| *serial >= floor));
    revoked.sort_unstable();
    revoked.dedup();
    if revoked.len() > MAX_REVOKED {
        bail!(
            "{} serials, where a revocation holds at most {MAX_REVOKED}; take all back with --all, and issue anew",
            revoked.len()
        );
    }
    Ok(Revocation { name, number, floor, revoked, signer: known.and_then(|known| known.signer) })
}

/// Returns the time as the serial, or the next serial above all issued or revoked ones if the clock
/// was set back a little. Nobody accepts a serial that is further ahead of the clock, so
/// certificates that a faulty clock dated so are passed over. A floor cannot be.
pub fn next_serial<E: Entry>(issued: &[E], revocation: Option<&Revocation>) -> anyhow::Result<u64> {
    let now = serial_now();
    let last = last_serial(now / 1_000_000_000);
    let revoked = revocation.into_iter().flat_map(|revocation| revocation.revoked.iter().copied());
    let used = issued.iter().map(Entry::serial).chain(revoked).filter(|serial| *serial < last);
    let floor = revocation.map_or(0, |revocation| revocation.floor);
    if floor > last {
        bail!(
            "all serials below {floor} are revoked, a time in ns that is ahead of the clock; check the clock, or make a \
             new name"
        );
    }
    Ok(used.max().map_or(0, |used| used + 1).max(floor).max(now))
}

/// Sends a revocation to the RIB. One that it has already is accepted.
pub fn send(card: &NameCard, revocation: Signed<Revocation>, context: &Context) -> anyhow::Result<()> {
    let request = EntityRequest::Revoke { proof: card.proof(), revocation };
    match context.client()?.ask(&Request::Entity { entity: None, request: request.into() })? {
        Response::Done => Ok(()),
        _ => bail!("the RIB answered another question"),
    }
}

#[cfg(test)]
#[path = "../../tests/unit/cli/revocation.rs"]
mod tests;
