//! `gdp-ctl grant revoke`: the owner's word on what no longer holds, with a number above the last one.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::Args;
use gdp::cert::{MAX_REVOKED, Revocation, Signed, issue};
use gdp::control::{EntityRequest, Response};
use gdp::identity::{SigningKey, VerifyKey};
use gdp::{Name, NameCard};

use super::super::paper::Paper;
use super::super::{Context, unix_now};
use super::add::next_serial;
use super::books::{Books, Entry, Holder};
use super::list::describe_revocation;
use crate::admin::{ClientError, Request};

/// Seconds that an expired certificate stays listed: a clock may be so much behind.
const CLOCKS_DIFFER: u64 = 86400;

/// The code of a refusal to go back to an earlier revocation.
const OLD_NUMBER: &str = "ReplayedSerial";

#[derive(Debug, Args)]
pub struct Options {
    /// The name card. The newest revocation is kept beside it, in CARD.revocation.
    card: PathBuf,
    /// What to take back: serials, as `gdp-ctl grant list` shows them, or certificate files. With nothing to take back, the
    /// newest revocation is published again.
    #[arg(value_name = "SERIAL|FILE")]
    serials: Vec<String>,
    /// All that was granted from here to this entity, such as a stolen robot.
    #[arg(long, value_name = "NAME")]
    entity: Vec<Name>,
    /// This delegate, and with it all that it granted.
    #[arg(long, value_name = "KEY")]
    delegate: Vec<VerifyKey>,
    /// All that anybody granted until now.
    #[arg(long)]
    all: bool,
    /// The owner's private key file. No delegate can revoke.
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    let books = Books::open(&options.card)?;
    let known = books.revocation()?;
    let anew =
        options.revokes().then(|| options.revoke(&books, known.as_ref().map(|(_, claims)| claims))).transpose()?;
    let (signed, claims) = match (anew, known) {
        (Some(anew), _) => {
            books.keep_revocation(&anew.0)?;
            anew
        }
        (None, Some(known)) => known,
        (None, None) => bail!("nothing of {} is revoked yet; say what to revoke", books.card().name()),
    };
    let file = books.revocation_path();
    let published = match publish(books.card(), signed, context) {
        Ok(()) => true,
        // It holds as soon as the fabric knows it; this machine need not be one that is connected.
        Err(error) if options.revokes() && matches!(error.downcast_ref(), Some(ClientError::NoDaemon { .. })) => {
            eprintln!(
                "gdp-ctl: not published, so it has no effect yet: {error}. Then, or on another machine with copies of {} and \
                 {}, run `gdp-ctl grant revoke {}`",
                options.card.display(),
                file.display(),
                options.card.display()
            );
            false
        }
        Err(error) => {
            let rolled_back =
                matches!(error.downcast_ref(), Some(ClientError::Refused { code, .. }) if code == OLD_NUMBER);
            let remedy = if rolled_back { "; if newer files have been lost, take all back with --all" } else { "" };
            return Err(error.context(format!("{} is kept, but not published{remedy}", file.display())));
        }
    };
    let mut value = describe_revocation(&claims);
    value["name"] = books.card().name().to_string().into();
    value["file"] = file.display().to_string().into();
    value["published"] = published.into();
    context.output.print(value, || {
        let told = if published { "published" } else { "not published" };
        format!("revocation {} of {:#}, {told}: {}", claims.number, claims.name, file.display())
    })
}

impl Options {
    fn revokes(&self) -> bool {
        self.all || !self.serials.is_empty() || !self.entity.is_empty() || !self.delegate.is_empty()
    }

    fn revoke(&self, books: &Books, known: Option<&Revocation>) -> anyhow::Result<(Signed<Revocation>, Revocation)> {
        let card = books.card();
        let path = self.key.as_deref().context("only the owner revokes: add --key OWNER.pem")?;
        let key = SigningKey::load(path)?;
        if key.verify_key() != *card.owner_key() {
            bail!("{} is not the owner of {}, and only the owner revokes", path.display(), card.name());
        }
        let grants = books.ledger()?;
        let floor = if self.all { Some(next_serial(&grants, known)?) } else { None };
        let claims = next(card.name(), known, &grants, &self.chosen(card, &grants)?, floor, unix_now())?;
        Ok((issue(&key, &claims)?, claims))
    }

    /// The serials that are to be revoked.
    fn chosen(&self, card: &NameCard, grants: &[Entry]) -> anyhow::Result<Vec<u64>> {
        let mut chosen = Vec::new();
        for text in &self.serials {
            chosen.push(match text.parse() {
                Ok(serial) => serial,
                Err(_) => Paper::load(Path::new(text))?.serial(card).with_context(|| text.clone())?,
            });
        }
        let entities = self.entity.iter().copied().map(Holder::Entity);
        for holder in entities.chain(self.delegate.iter().copied().map(Holder::Delegate)) {
            let before = chosen.len();
            chosen.extend(grants.iter().filter(|grant| grant.to == holder).map(|grant| grant.serial));
            if chosen.len() == before {
                bail!("nothing was granted to {holder} from here; name its certificate files or their serials");
            }
        }
        Ok(chosen)
    }
}

/// The revocation that follows `known`. With a new `floor` nothing that was said before matters, so it is no harm if that was
/// lost: the number is then the time, which is above any earlier one.
fn next(
    name: Name,
    known: Option<&Revocation>,
    grants: &[Entry],
    chosen: &[u64],
    floor: Option<u64>,
    now: u64,
) -> anyhow::Result<Revocation> {
    let number = known.map_or(0, |known| known.number).checked_add(1).context("the numbers are used up")?;
    let (number, floor) = match floor {
        Some(floor) => (number.max(now), floor),
        None => (number, known.map_or(0, |known| known.floor)),
    };
    let over = |serial: &u64| {
        let grant = grants.iter().find(|grant| grant.serial == *serial);
        *serial < floor || grant.is_some_and(|grant| grant.not_after.saturating_add(CLOCKS_DIFFER) < now)
    };
    let mut revoked: Vec<u64> = known.map_or_else(Vec::new, |known| known.revoked.clone());
    revoked.retain(|serial| !over(serial));
    revoked.extend(chosen.iter().filter(|serial| **serial >= floor));
    revoked.sort_unstable();
    revoked.dedup();
    if revoked.len() > MAX_REVOKED {
        bail!(
            "{} serials, where a revocation holds at most {MAX_REVOKED}; take all back with --all, and grant anew",
            revoked.len()
        );
    }
    Ok(Revocation { name, number, floor, revoked })
}

fn publish(card: &NameCard, revocation: Signed<Revocation>, context: &Context) -> anyhow::Result<()> {
    let request = EntityRequest::Revoke { proof: card.proof(), revocation };
    match context.client()?.ask_control(&Request::Entity { entity: None, request: request.into() })? {
        Response::Done => Ok(()),
        _ => bail!("the RIB answered another question"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: u64 = 1_800_000_000;

    #[test]
    fn what_is_taken_back_stays_so_until_it_has_expired() {
        let first = revoke(None, &[], &[7, 3, 7], None).unwrap();
        assert_eq!((first.number, first.floor, first.revoked.as_slice()), (1, 0, &[3, 7][..]));
        // Of 3 it is known when it ends, of 7 it is not.
        let entry = |not_after| Entry {
            serial: 3,
            publish: true,
            read: false,
            to: Holder::Entity(Name::default()),
            not_before: 0,
            not_after,
            file: "x".into(),
        };
        for (not_after, left) in [(NOW, vec![3, 5, 7]), (NOW - CLOCKS_DIFFER - 1, vec![5, 7])] {
            assert_eq!(revoke(Some(&first), &[entry(not_after)], &[5], None).unwrap().revoked, left);
        }
    }

    #[test]
    fn all_at_once_needs_no_memory() {
        let known = revoke(None, &[], &[7], None).unwrap();
        for known in [None, Some(&known)] {
            let all = revoke(known, &[], &[5, 200], Some(100)).unwrap();
            assert_eq!((all.number, all.floor, all.revoked.as_slice()), (NOW, 100, &[200][..]));
            let more = revoke(Some(&all), &[], &[150, 99], None).unwrap();
            assert_eq!((more.number, more.floor, more.revoked.as_slice()), (NOW + 1, 100, &[150, 200][..]));
        }
    }

    #[test]
    fn a_list_that_is_full_says_how_to_go_on() {
        let serials: Vec<u64> = (0..=MAX_REVOKED as u64).collect();
        assert!(revoke(None, &[], &serials[1..], None).is_ok());
        assert!(revoke(None, &[], &serials, None).unwrap_err().to_string().contains("--all"));
        let last = Revocation { name: Name::default(), number: u64::MAX, floor: 0, revoked: vec![] };
        assert!(revoke(Some(&last), &[], &[1], None).is_err());
    }

    fn revoke(
        known: Option<&Revocation>,
        grants: &[Entry],
        chosen: &[u64],
        floor: Option<u64>,
    ) -> anyhow::Result<Revocation> {
        next(Name::default(), known, grants, chosen, floor, NOW)
    }
}
