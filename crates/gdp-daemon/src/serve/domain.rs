//! The daemon's trust domain: reads its files when they change, keeps what must outlive a restart,
//! tells neighbours of revocations and of renewed papers, asks the RIB about invitations, and
//! closes links when what they rest on ends. The rules are in [`gdp_core::domain`] and
//! [`crate::domain`].

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use gdp_core::cert::{CertError, Revocation, Signed};
use gdp_core::domain::{CurrentCredentials, PaperFileError};
use gdp_core::identity::Identity;
use gdp_core::name::NameProof;
use gdp_core::revocations::{Kept, RevocationFile};
use gdp_core::secret_file::SecretFileError;
use gdp_core::{cbor, secret_file};
use gdp_link::link::Link;
use gdp_proto::control::{EntityRequest, Refusal, RefusalCode, Request, Response};
use gdp_wire::Name;
use tokio::time::sleep;

use super::core::Next;
use super::revocation_store::RevocationStore;
use super::{Daemon, links};
use crate::config::DomainConfig;
use crate::domain::{Credentials, Domain, DomainError, Invitations, MAX_USED, Trust, Used};
use gdp_util::file_watch::{FileSet, FileWatcher};
use gdp_util::unix_time::unix_seconds;

/// How often the files are looked at, and whether something has ended.
const LOOK: Duration = Duration::from_millis(250);

/// Bytes of the revocations of all domains that this one knows.
const MAX_REVOCATIONS: usize = 256 << 10;

/// Bytes of the invitations that were used.
const MAX_INVITATIONS: usize = 128 * MAX_USED;

/// Why a daemon cannot be a member of its domain.
#[derive(Debug, thiserror::Error)]
pub enum MembershipError {
    #[error(transparent)]
    File(#[from] PaperFileError),
    #[error("domain: {0}")]
    Domain(#[from] DomainError),
    #[error(transparent)]
    Kept(#[from] SecretFileError),
}

/// What is kept beside the switch's key.
pub struct StoredDomain {
    revocations: RevocationFile,
    invitations: PathBuf,
    /// Of what [`Domain::changes`] counts.
    keeper: RevocationStore,
}

impl StoredDomain {
    /// The daemon's membership, and what an earlier daemon knew of the domain.
    pub fn recall(
        config: &DomainConfig,
        identity: &Identity,
        identity_file: &Path,
    ) -> Result<(Self, Domain), MembershipError> {
        let papers = Arc::new(config.files.load()?);
        let mut trust = Trust::new(identity.name(), papers, config.members_only)?;
        let revocations = RevocationFile::new(identity_file.with_extension("domain-revocations"), MAX_REVOCATIONS);
        for (Kept { proof, revocation, .. }, _) in revocations.load()? {
            // Of a domain that is no peer any more, perhaps.
            let _ = trust.take_revocation(&proof, &revocation);
        }
        let invitations = identity_file.with_extension("invitations");
        let used = load_used(&invitations)?;
        match trust.own(unix_seconds()) {
            Ok(own) => tracing::info!("{} of domain {:#} until Unix time {}", own.role, own.domain, own.not_after),
            Err(error) => tracing::error!("no link to anybody of a domain: {error}"),
        }
        Ok((
            Self { revocations, invitations, keeper: RevocationStore::new(0) },
            Domain::new(trust, Invitations::recall(used)),
        ))
    }
}

fn load_used(path: &Path) -> Result<Vec<Used>, SecretFileError> {
    let bytes = match secret_file::read(path, MAX_INVITATIONS) {
        Err(error) if error.is_not_found() => return Ok(Vec::new()),
        bytes => bytes?,
    };
    cbor::decode(&bytes, MAX_INVITATIONS).map_err(|error| {
        let reason = "without it, each of them may admit another: remove it to begin anew";
        SecretFileError::malformed(path, format!("not a list of invitations ({error}); {reason}"))
    })
}

/// Reads the files when they change, and closes links at the moment at which what they rest on
/// ends.
pub async fn watch(daemon: Arc<Daemon>, config: DomainConfig, shown: CurrentCredentials) {
    let mut files = FileSet::new(&FileWatcher::start(), config.files.paths());
    loop {
        tokio::select! {
            () = sleep(LOOK) => daemon.recheck_links(true),
            () = files.changed() => match load_and_renew(&daemon, &config) {
                Ok(papers) => {
                    shown.set(papers.clone());
                    daemon.show_renewed(&papers);
                }
                Err(error) => {
                    tracing::error!("the renewed membership is not taken, what was there goes on to count: {error}")
                }
            },
        }
    }
}

fn load_and_renew(daemon: &Arc<Daemon>, config: &DomainConfig) -> Result<Arc<Credentials>, MembershipError> {
    let credentials = config.files.load()?;
    daemon.renew(credentials, config)
}

impl Daemon {
    fn renew(
        self: &Arc<Self>,
        papers: Credentials,
        config: &DomainConfig,
    ) -> Result<Arc<Credentials>, MembershipError> {
        let papers = Arc::new(papers);
        if let Some(domain) = &mut self.core().domain {
            domain.trust.renew(papers.clone(), config.members_only)?;
        }
        tracing::info!("took renewed papers of the domain");
        self.recheck_links(false);
        // The RIB shows the membership to other domains.
        self.report_in_full();
        Ok(papers)
    }

    fn show_renewed(self: &Arc<Self>, papers: &Arc<Credentials>) {
        let links: Vec<Link> = self.core().links.values().map(|state| state.link.clone()).collect();
        for link in links {
            let request = Request::Papers(Box::new(Credentials::clone(papers)));
            self.spawn(async move {
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

    /// Judges links anew, all or only those whose time has come, and closes those that may not be.
    pub(super) fn recheck_links(self: &Arc<Self>, only_ended: bool) {
        let (refused, lost) = self.core().recheck(unix_seconds(), only_ended);
        for (link, reason) in refused {
            tracing::warn!(peer = %format_args!("{:#}", link.peer().name), %reason, "closing a link");
            link.close(&reason);
        }
        for entity in lost {
            self.spawn(links::detach_lost(self.clone(), entity));
        }
        if !only_ended {
            self.topology_changed();
        }
    }

    /// Takes in what a domain has revoked, and passes it on if it is news. `from`: the link it came
    /// by.
    pub(super) async fn take_revocation(
        self: &Arc<Self>,
        proof: NameProof,
        revocation: Signed<Revocation>,
        from: Option<u32>,
    ) -> Response {
        let taken = {
            let mut core = self.core();
            let Some(domain) = &mut core.domain else { return Response::Done };
            domain.trust.take_revocation(&proof, &revocation).inspect(|news| domain.changes += u64::from(*news))
        };
        match taken {
            Err(error) => {
                let older = matches!(error, CertError::RolledBack { .. });
                let code = if older { RefusalCode::ReplayedSerial } else { RefusalCode::Malformed };
                return Refusal::new(code, error.to_string()).into();
            }
            // The last attempt to keep it may have failed.
            Ok(false) => return self.kept_domain().await,
            Ok(true) => {}
        }
        tracing::info!("a domain has revoked some of what it issued");
        self.recheck_links(false);
        if let Ok(domain) = proof.name() {
            self.core().reconsider(domain, None);
            self.send_effects();
        }
        let others: Vec<Link> = {
            let core = self.core();
            core.links.values().map(|state| &state.link).filter(|l| Some(l.local_id()) != from).cloned().collect()
        };
        for link in others {
            let request = Request::DomainRevoked { proof, revocation: revocation.clone() };
            self.spawn(tell(link, request));
        }
        self.kept_domain().await
    }

    /// What a domain that is known here has revoked does not go to the RIB like the revocation of a
    /// name, but to all switches.
    pub(super) fn is_of_domain(&self, request: &EntityRequest) -> Option<(NameProof, Signed<Revocation>)> {
        let EntityRequest::Revoke { proof, revocation } = request else { return None };
        let known = self.core().domain.as_ref().is_some_and(|d| proof.name().is_ok_and(|name| d.trust.knows(&name)));
        known.then(|| (*proof, revocation.clone()))
    }

    /// Tells a new link what the domains have revoked that this daemon knows.
    pub(super) fn tell_revocations(self: &Arc<Self>, link: &Link) {
        let known: Vec<Kept> = match &self.core().domain {
            Some(domain) => domain.trust.revocations().cloned().collect(),
            None => return,
        };
        for Kept { proof, revocation, .. } in known {
            self.spawn(tell(link.clone(), Request::DomainRevoked { proof, revocation }));
        }
    }

    /// A peer shows renewed papers.
    pub(super) async fn take_credentials(self: &Arc<Self>, link: &Link, papers: Credentials) -> Response {
        let papers = Arc::new(papers);
        let question = self.core().question(link, &papers);
        if let Some(question) = question
            && let Err(refusal) = self.ask_admitted(question).await
        {
            return refusal.into();
        }
        let renewed = self.core().renew_link(link, &papers);
        match renewed {
            Ok(()) => {
                link.set_credentials(papers);
                // The rights of a neighbouring domain are stated.
                self.topology_changed();
                Response::Done
            }
            Err(reason) => Refusal::new(RefusalCode::NotEntitled, reason).into(),
        }
    }

    /// Asks the RIB whether an entity is the one that its invitation has admitted.
    pub(super) async fn ask_admitted(self: &Arc<Self>, request: Request) -> Result<(), Refusal> {
        let Request::Admitted { entity, membership, .. } = &request else { return Ok(()) };
        let (entity, membership) = (*entity, membership.clone());
        let next = {
            let mut core = self.core();
            let next = core.for_rib(request);
            core.store_first(next)
        };
        match self.complete(next).await {
            Response::Refused(refusal) => Err(refusal),
            _ => {
                if let (Some(domain), Ok(Some(invite))) = (&mut self.core().domain, membership.invite_unverified())
                    && !domain.invitations.has_admitted(invite.serial, &entity)
                {
                    domain.invitations.remember(&invite, entity);
                    domain.changes += 1;
                }
                // The RIB has kept it; what is not kept here is asked for again.
                let _ = self.keep_domain().await;
                Ok(())
            }
        }
    }

    /// Says that somebody is admitted once that is kept; if it cannot be, nobody was.
    pub(super) async fn keep_invitation(self: &Arc<Self>, new: Option<u64>) -> Response {
        let response = self.kept_domain().await;
        if let (Response::Refused(_), Some(serial), Some(domain)) = (&response, new, &mut self.core().domain) {
            domain.invitations.forget(serial);
        }
        response
    }

    /// Says that it is done once it is kept.
    async fn kept_domain(self: &Arc<Self>) -> Response {
        self.keep_domain().await.map_or_else(Response::from, |()| Response::Done)
    }

    /// Returns once what is known of the domain by now is in its files; to be called before it is
    /// said to be done.
    pub(super) async fn keep_domain(self: &Arc<Self>) -> Result<(), Refusal> {
        let Some(StoredDomain { revocations, invitations, keeper }) = &self.domain else { return Ok(()) };
        let changes = self.core().domain.as_ref().map_or(0, |domain| domain.changes);
        let collect = || {
            let core = self.core();
            let domain = core.domain.as_ref()?;
            let revocations: Vec<Kept> = domain.trust.revocations().cloned().collect();
            let used: Vec<Used> = domain.invitations.all().copied().collect();
            Some((domain.changes, (revocations, used)))
        };
        let (file, path) = (revocations.clone(), invitations.clone());
        let write = move |(revocations, used): (Vec<Kept>, Vec<Used>)| {
            file.save(&revocations)?;
            let malformed = |error| SecretFileError::malformed(&path, error);
            secret_file::replace(&path, &cbor::encode(&used).map_err(malformed)?)
        };
        keeper.keep(changes, collect, write).await
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

/// Whether a request is answered here whoever sends it, and then the answer.
pub async fn answer(daemon: &Arc<Daemon>, link: &Link, request: Request) -> Result<Response, Request> {
    match request {
        Request::Papers(papers) => Ok(daemon.take_credentials(link, *papers).await),
        Request::DomainRevoked { proof, revocation } => {
            Ok(daemon.take_revocation(proof, revocation, Some(link.local_id())).await)
        }
        other => Err(other),
    }
}

/// The RIB's answer about an invitation.
pub fn admitted(domain: Option<&mut Domain>, entity: Name, membership: &gdp_core::cert::Membership, now: u64) -> Next {
    let refuse = |code, reason: String| Next::Answer(Refusal::new(code, reason).into());
    let Some(domain) = domain else {
        return refuse(RefusalCode::Unsupported, "the RIB here is of no domain: configure domain".into());
    };
    let home = domain.trust.home();
    let cert = match membership.verify(home, domain.trust.revocation(&home), now) {
        Ok(cert) => cert,
        Err(error) => return refuse(RefusalCode::NotEntitled, error.to_string()),
    };
    let Ok(Some(invite)) = membership.invite_unverified() else {
        return refuse(RefusalCode::Malformed, "the membership rests on no invitation".into());
    };
    if cert.entity != entity {
        return refuse(RefusalCode::WrongEntity, format!("the membership is of {}, not of {entity}", cert.entity));
    }
    match domain.invitations.admit(&invite, entity, now) {
        Ok(new) => {
            domain.changes += u64::from(new);
            Next::KeepInvitation { new: new.then_some(invite.serial) }
        }
        Err(reason) => refuse(RefusalCode::NotEntitled, reason.to_string()),
    }
}
