//! The daemon's trust domain.
//!
//! Reloads its files when they change, floods revocations and renewed credentials to neighbours,
//! and asks the RIB about invitations. Closes links when their credentials end. The rules are in
//! [`gdp_core::domain`] and [`crate::domain`].

use std::sync::Arc;
use std::time::{Duration, Instant};

use gdp_core::cert::{CertError, Revocation, Signed};
use gdp_core::domain::CurrentCredentials;
use gdp_core::name::NameProof;
use gdp_core::revocations::SignedRevocation;
use gdp_link::link::{CloseCode, Link};
use gdp_proto::control::{EntityRequest, Refusal, RefusalCode, Request, Response};
use gdp_util::file_watch::{FileSet, FileWatcher};
use gdp_util::ticks::next_tick;
use tokio::time::sleep_until;

use super::daemon::Daemon;
use super::detach::detach_lost;
use super::domain_store::MembershipError;
use crate::config::DomainConfig;
use crate::domain::{Admitted, Credentials};

/// The interval between checks for expired admissions.
const LOOK: Duration = Duration::from_secs(1);

/// Reloads the files when they change, and closes links when their credentials expire. Stores in
/// `current` the credentials for new links.
pub async fn watch(daemon: Arc<Daemon>, config: DomainConfig, current: CurrentCredentials) {
    let mut files = FileSet::new(&FileWatcher::start(), config.files.paths());
    loop {
        tokio::select! {
            () = sleep_until(next_tick(LOOK, Instant::now()).into()) => recheck_links(&daemon, true),
            () = files.changed() => match renew(&daemon, &config) {
                Ok(credentials) => {
                    current.set(credentials.clone());
                    show_renewed(&daemon, &credentials);
                }
                Err(error) => {
                    tracing::error!("the renewed membership is not taken, what was there goes on to count: {error}")
                }
            },
        }
    }
}

fn renew(daemon: &Arc<Daemon>, config: &DomainConfig) -> Result<Arc<Credentials>, MembershipError> {
    let credentials = Arc::new(config.files.load()?);
    if let Some(domain) = &mut daemon.core().membership.domain {
        domain.trust.renew(credentials.clone(), config.members_only)?;
    }
    tracing::info!("took renewed papers of the domain");
    recheck_links(daemon, false);
    // The RIB shows the membership to other domains.
    daemon.report_in_full();
    Ok(credentials)
}

fn show_renewed(daemon: &Arc<Daemon>, credentials: &Arc<Credentials>) {
    let links: Vec<Link> = daemon.core().switch.links.values().map(|state| state.link.clone()).collect();
    for link in links {
        let request = Request::Credentials(Box::new(Credentials::clone(credentials)));
        daemon.spawn(async move {
            match link.request(&request).await {
                Ok(Response::Refused(refusal)) => {
                    tracing::warn!(
                        peer = %format_args!("{:#}", link.peer().name),
                        %refusal,
                        "a peer does not take the renewed membership"
                    );
                }
                Ok(_) => {}
                Err(error) => tracing::debug!(%error, "a peer was not told of the renewed membership"),
            }
        });
    }
}

/// Readmits the peers of all links, or only of those whose admission has expired. Closes the links
/// of refused peers.
fn recheck_links(daemon: &Arc<Daemon>, only_ended: bool) {
    let (refused, lost) = daemon.core().recheck(only_ended);
    for (link, reason) in refused {
        tracing::warn!(peer = %format_args!("{:#}", link.peer().name), %reason, "closing a link");
        link.refuse(CloseCode::NotAdmitted, &reason);
    }
    for entity in lost {
        daemon.spawn(detach_lost(daemon.clone(), entity));
    }
    if !only_ended {
        daemon.topology_changed();
    }
}

/// Accepts a revocation by a domain, and floods it if it is new. `from` is the link that it came
/// over.
pub async fn take_revocation(
    daemon: &Arc<Daemon>,
    proof: NameProof,
    revocation: Signed<Revocation>,
    from: Option<&Link>,
) -> Response {
    let accepted = daemon.core().membership.take_revocation(&proof, &revocation);
    match accepted {
        None => return Response::Done,
        Some(Err(error)) => {
            let older = matches!(error, CertError::RolledBack { .. });
            let code = if older { RefusalCode::ReplayedSerial } else { RefusalCode::Malformed };
            return Refusal::new(code, error.to_string()).into();
        }
        // The last attempt to save it may have failed.
        Some(Ok(false)) => return saved(daemon).await,
        Some(Ok(true)) => {}
    }
    tracing::info!("a domain has revoked some of what it issued");
    recheck_links(daemon, false);
    if let Ok(domain) = proof.name() {
        daemon.core().reconsider(domain);
        daemon.send_effects();
    }
    let from = from.map(Link::local_id);
    let others: Vec<Link> = {
        let links = &daemon.core().switch.links;
        links.values().map(|state| &state.link).filter(|link| Some(link.local_id()) != from).cloned().collect()
    };
    for link in others {
        let request = Request::DomainRevoked { proof, revocation: revocation.clone() };
        daemon.spawn(tell(link, request));
    }
    saved(daemon).await
}

/// Confirms the state of the domain once it is saved.
async fn saved(daemon: &Daemon) -> Response {
    daemon.save_domain().await.map_or_else(Response::from, |()| Response::Done)
}

/// Returns a request's revocation by a known domain. Unlike the revocation of a name, it goes to
/// all switches instead of the RIB.
pub fn domain_revocation(daemon: &Daemon, request: &EntityRequest) -> Option<(NameProof, Signed<Revocation>)> {
    let EntityRequest::Revoke { proof, revocation } = request else { return None };
    let core = daemon.core();
    let domain = core.membership.domain.as_ref()?;
    domain.trust.knows(&proof.name().ok()?).then(|| (*proof, revocation.clone()))
}

/// Sends the revocations of all known domains over a new link.
pub fn tell_revocations(daemon: &Daemon, link: &Link) {
    let known: Vec<SignedRevocation> = match &daemon.core().membership.domain {
        Some(domain) => domain.trust.revocations().cloned().collect(),
        None => return,
    };
    for SignedRevocation { proof, revocation, .. } in known {
        daemon.spawn(tell(link.clone(), Request::DomainRevoked { proof, revocation }));
    }
}

async fn tell(link: Link, request: Request) {
    match link.request(&request).await {
        Ok(Response::Refused(refusal)) => {
            tracing::debug!(peer = %format_args!("{:#}", link.peer().name), %refusal, "a peer does not take a \
                                                  revocation");
        }
        Ok(_) => {}
        Err(error) => tracing::debug!(%error, "a peer was not told of a revocation; it is when it has a link again"),
    }
}

/// Checks the renewed credentials of a peer, and stores them if the peer keeps its link.
async fn take_credentials(daemon: &Arc<Daemon>, link: &Link, credentials: Credentials) -> Response {
    let credentials = Arc::new(credentials);
    let question = daemon.core().question(link, &credentials);
    if let Some(question) = question
        && let Err(refusal) = ask_admitted(daemon, question).await
    {
        return refusal.into();
    }
    let renewed = daemon.core().renew_link(link, &credentials);
    match renewed {
        Ok(()) => {
            link.set_credentials(credentials);
            // The link state includes the rights of a neighbouring domain.
            daemon.topology_changed();
            Response::Done
        }
        Err(reason) => Refusal::new(RefusalCode::NotEntitled, reason).into(),
    }
}

/// Asks the RIB to confirm that an entity is the one that its invitation admitted.
pub async fn ask_admitted(daemon: &Arc<Daemon>, request: Request) -> Result<(), Refusal> {
    let Request::Admitted { entity, membership, .. } = &request else { return Ok(()) };
    let (entity, membership) = (*entity, membership.clone());
    let until = membership.until_unverified().unwrap_or_default();
    if let Response::Refused(refusal) = daemon.answer(|core| core.for_rib(request)).await {
        return Err(refusal);
    }
    if let (Some(domain), Ok(Some(invite))) = (&mut daemon.core().membership.domain, membership.invite_unverified())
        && !domain.invitations.has_admitted(invite.serial, &entity, until)
    {
        domain.invitations.remember(&invite, Admitted { entity, until });
        domain.changes += 1;
    }
    // The RIB has saved it. If saving fails here, this switch asks the RIB again later.
    let _ = daemon.save_domain().await;
    Ok(())
}

/// Answers requests that any peer may send. Returns other requests as the error.
pub async fn answer(daemon: &Arc<Daemon>, link: &Link, request: Request) -> Result<Response, Request> {
    match request {
        Request::Credentials(credentials) => Ok(take_credentials(daemon, link, *credentials).await),
        Request::DomainRevoked { proof, revocation } => {
            Ok(take_revocation(daemon, proof, revocation, Some(link)).await)
        }
        other => Err(other),
    }
}
