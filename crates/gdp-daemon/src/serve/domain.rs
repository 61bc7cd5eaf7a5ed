//! The daemon's trust domain: reads its files when they change, tells neighbours of revocations and
//! of renewed credentials, asks the RIB about invitations, and closes links when what they rest on
//! ends. The rules are in [`gdp_core::domain`] and [`crate::domain`].

use std::sync::Arc;
use std::time::Duration;

use gdp_core::cert::{CertError, Revocation, Signed};
use gdp_core::domain::CurrentCredentials;
use gdp_core::name::NameProof;
use gdp_core::revocations::SignedRevocation;
use gdp_link::link::Link;
use gdp_proto::control::{EntityRequest, Refusal, RefusalCode, Request, Response};
use gdp_util::file_watch::{FileSet, FileWatcher};
use tokio::time::sleep;

use super::daemon::Daemon;
use super::detach::detach_lost;
use super::domain_store::MembershipError;
use crate::config::DomainConfig;
use crate::domain::Credentials;

/// How often the files are looked at, and whether something has ended.
const LOOK: Duration = Duration::from_millis(250);

/// Reads the files when they change, and closes links at the moment at which what they rest on
/// ends. `current`: the credentials that new links show.
pub async fn watch(daemon: Arc<Daemon>, config: DomainConfig, current: CurrentCredentials) {
    let mut files = FileSet::new(&FileWatcher::start(), config.files.paths());
    loop {
        tokio::select! {
            () = sleep(LOOK) => recheck_links(&daemon, true),
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
        let request = Request::Papers(Box::new(Credentials::clone(credentials)));
        daemon.spawn(async move {
            match link.request(&request).await {
                Ok(Response::Refused(refusal)) => {
                    tracing::warn!(peer = %format_args!("{:#}", link.peer().name), %refusal, "a peer does not take the renewed membership");
                }
                Ok(_) => {}
                Err(error) => tracing::debug!(%error, "a peer was not told of the renewed membership"),
            }
        });
    }
}

/// Admits the peers of links again, of all or only of those whose time has come, and closes links
/// whose peers are not.
fn recheck_links(daemon: &Arc<Daemon>, only_ended: bool) {
    let (refused, lost) = daemon.core().recheck(only_ended);
    for (link, reason) in refused {
        tracing::warn!(peer = %format_args!("{:#}", link.peer().name), %reason, "closing a link");
        link.close(&reason);
    }
    for entity in lost {
        daemon.spawn(detach_lost(daemon.clone(), entity));
    }
    if !only_ended {
        daemon.topology_changed();
    }
}

/// Takes in what a domain has revoked, and passes it on if it is news. `from`: the link it came by.
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

/// Confirms what is known of the domain once it is saved.
async fn saved(daemon: &Daemon) -> Response {
    daemon.save_domain().await.map_or_else(Response::from, |()| Response::Done)
}

/// A revocation of a domain that is known here. It does not go to the RIB like the revocation of a
/// name, but to all switches.
pub fn domain_revocation(daemon: &Daemon, request: &EntityRequest) -> Option<(NameProof, Signed<Revocation>)> {
    let EntityRequest::Revoke { proof, revocation } = request else { return None };
    let core = daemon.core();
    let domain = core.membership.domain.as_ref()?;
    domain.trust.knows(&proof.name().ok()?).then(|| (*proof, revocation.clone()))
}

/// Tells a new link what the domains have revoked that this daemon knows.
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

/// A peer shows renewed credentials.
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
            // The rights of a neighbouring domain are stated.
            daemon.topology_changed();
            Response::Done
        }
        Err(reason) => Refusal::new(RefusalCode::NotEntitled, reason).into(),
    }
}

/// Asks the RIB whether an entity is the one that its invitation has admitted.
pub async fn ask_admitted(daemon: &Arc<Daemon>, request: Request) -> Result<(), Refusal> {
    let Request::Admitted { entity, membership, .. } = &request else { return Ok(()) };
    let (entity, membership) = (*entity, membership.clone());
    if let Response::Refused(refusal) = daemon.answer(|core| core.for_rib(request)).await {
        return Err(refusal);
    }
    if let (Some(domain), Ok(Some(invite))) = (&mut daemon.core().membership.domain, membership.invite_unverified())
        && !domain.invitations.has_admitted(invite.serial, &entity)
    {
        domain.invitations.remember(&invite, entity);
        domain.changes += 1;
    }
    // The RIB has saved it; what is not saved here is asked for again.
    let _ = daemon.save_domain().await;
    Ok(())
}

/// Whether a request is answered here whoever sends it, and then the answer.
pub async fn answer(daemon: &Arc<Daemon>, link: &Link, request: Request) -> Result<Response, Request> {
    match request {
        Request::Papers(credentials) => Ok(take_credentials(daemon, link, *credentials).await),
        Request::DomainRevoked { proof, revocation } => {
            Ok(take_revocation(daemon, proof, revocation, Some(link)).await)
        }
        other => Err(other),
    }
}
