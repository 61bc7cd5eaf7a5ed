//! Sends statements to the RIB: signed, with increasing serials, over one or several attachments.
//!
//! The supervisor decides when to send them.

use gdp_wire::Name;

use super::attachment::Attachment;
use super::error::NodeError;
use super::state::{LIFETIME, State};
use super::statement::{Stated, Statement};
use gdp_core::cert::{Advert, AdvertOp, Revocation, RtCert, Signed, issue};
use gdp_core::name::{NamePrefix, NameProof};
use gdp_proto::control::{EntityRequest, Record, RecordKey, RefusalCode, Request, Response};
use gdp_util::unix_time::unix_seconds;

impl State {
    /// Attaches to the switch, which then carries this entity's traffic. Learns the serial that the
    /// next statement must exceed.
    pub async fn attach(&self, attachment: &Attachment) -> Result<(), NodeError> {
        let mut serial = self.serial.lock().await;
        self.attach_locked(attachment, &mut serial).await?;
        self.send_path.publications.all().iter().for_each(|publication| publication.sealer.store_again());
        self.statements.lock().values_mut().for_each(|standing| standing.done &= !bit(attachment));
        Ok(())
    }

    async fn attach_locked(&self, attachment: &Attachment, serial: &mut Option<u64>) -> Result<(), NodeError> {
        let switch = attachment.link.peer().name;
        let not_after = unix_seconds() + u64::from(LIFETIME);
        let rt_cert = issue(self.identity.key(), &RtCert { entity: self.identity.name(), switch, not_after })?;
        // A node that has already sent statements resumes. A restarted node does not know the
        // statements of an earlier process.
        let (resumes, lane) = (serial.is_some(), attachment.lane);
        match self.ask_in_turn(attachment, EntityRequest::Attach { rt_cert, resumes, lane }).await? {
            Response::Attached { serial: floor } => *serial = Some(floor.max(serial.unwrap_or(0))),
            _ => return Err(NodeError::Protocol("to an attachment")),
        }
        Ok(())
    }

    /// Sends one statement to the RIB, if it belongs on this link and has not been sent since the
    /// last [`Self::attach`].
    ///
    /// A statement about sending applies to all links, whichever is the main one. A statement about
    /// receiving applies to the main link and moves with it, unless every link is to deliver the
    /// name.
    pub async fn state(&self, attachment: &Attachment, name: Name, stated: Stated) -> Result<(), NodeError> {
        if stated == Stated::Called
            && let Some(costs) = attachment.watch_costs().await
        {
            self.set_costs(attachment.lane, costs);
        }
        let mut serial = self.serial.lock().await;
        let several = self.send_path.links.slots().len() > 1;
        let (statement, everywhere) = {
            let mut statements = self.statements.lock();
            let Some(standing) = statements.get_mut(&(name, stated)) else { return Ok(()) };
            let everywhere = several && (stated.sends() || standing.duplicate);
            let belongs = everywhere || self.send_path.links.is_main(attachment);
            if !belongs || standing.over || standing.done & bit(attachment) != 0 {
                return Ok(());
            }
            if !everywhere {
                // From here on, the RIB may have it for this link only, with or without an answer.
                standing.done = 0;
            }
            (standing.statement.clone(), everywhere)
        };
        let op = stated.role().op();
        let response = self.ask_signed(attachment, &mut serial, op, name, |advert| match statement.clone() {
            Statement::Write { proof, ad_cert } => EntityRequest::Advertise { proof, ad_cert, advert, everywhere },
            Statement::Read { proof, grant } => EntityRequest::Subscribe { proof, grant, advert, everywhere },
        });
        let Response::Peers(peers) = response.await? else { return Err(NodeError::Protocol("to a statement")) };
        // A newer update may have arrived before. The RIB then sends the complete state again.
        let _ = self.take_peers(name, stated.role(), &peers);
        // Unless a renewed statement has replaced it in the meantime.
        if let Some(standing) = self.statements.lock().get_mut(&(name, stated)).filter(|it| it.statement == statement) {
            standing.done = if everywhere { standing.done | bit(attachment) } else { bit(attachment) };
        }
        if let Some(publication) = self.send_path.publications.get(&name).filter(|_| stated == Stated::Published) {
            publication.sealer.stated();
        }
        if everywhere {
            self.restate();
        }
        self.send_path.upkeep.notify_one();
        Ok(())
    }

    /// Sends all statements. Returns `false` if one was refused or not delivered, so that the
    /// caller retries.
    pub async fn state_all(&self, attachment: &Attachment) -> bool {
        let standing: Vec<_> = self.statements.lock().keys().copied().collect();
        let mut all = true;
        for (name, stated) in standing {
            if let Err(error) = self.state(attachment, name, stated).await {
                tracing::warn!(%name, %error, "could not be {stated} again");
                all = false;
                // Further statements would also fail, and delay others.
                if matches!(error, NodeError::Link(_) | NodeError::Detached(_)) {
                    break;
                }
            }
        }
        all
    }

    /// Withdraws a name. The RIB removes the other statements about the name as well, so they are
    /// sent again.
    pub async fn state_withdrawal(&self, attachment: &Attachment, name: Name, stated: Stated) -> Result<(), NodeError> {
        let mut serial = self.serial.lock().await;
        if self.statements.lock().contains_key(&(name, stated)) {
            return Ok(());
        }
        let request = |advert| EntityRequest::Withdraw { advert };
        self.ask_signed(attachment, &mut serial, AdvertOp::Withdraw, name, request).await?;
        for other in Stated::ALL {
            if let Some(standing) = self.statements.lock().get_mut(&(name, other)) {
                standing.done = 0;
                self.restate();
                // The RIB has removed its keys as well.
                if let Some(publication) = self.send_path.publications.get(&name).filter(|_| other == Stated::Published)
                {
                    publication.sealer.store_again();
                }
            }
        }
        Ok(())
    }

    /// Notifies all links that statements may be due.
    pub fn restate(&self) {
        self.send_path.links.slots().iter().for_each(|lane| lane.unstated.notify_one());
    }

    /// Queries the records of names with this prefix, starting after the record `after`. Returns
    /// them, and whether there are more.
    pub async fn query(
        &self,
        attachment: &Attachment,
        prefix: NamePrefix,
        after: Option<RecordKey>,
    ) -> Result<(Vec<Record>, bool), NodeError> {
        match ask(attachment, EntityRequest::Query { prefix, after }).await? {
            Response::Records { records, truncated } => Ok((records, truncated)),
            _ => Err(NodeError::Protocol("to a query")),
        }
    }

    /// Sends a revocation to a RIB that lacks it.
    pub async fn pass_on(
        &self,
        attachment: &Attachment,
        proof: NameProof,
        revocation: Signed<Revocation>,
    ) -> Result<(), NodeError> {
        ask(attachment, EntityRequest::Revoke { proof, revocation }).await.map(drop)
    }

    /// Sends a signed statement under the next serial. Repeats it once under a higher serial if
    /// another process has sent statements for the entity since it attached, such as a command-line
    /// tool.
    async fn ask_signed(
        &self,
        attachment: &Attachment,
        serial: &mut Option<u64>,
        op: AdvertOp,
        name: Name,
        request: impl Fn(Signed<Advert>) -> EntityRequest,
    ) -> Result<Response, NodeError> {
        match self.ask_in_turn(attachment, request(self.advert(attachment, op, name, serial)?)).await {
            Err(NodeError::Refused(refusal)) if refusal.code == RefusalCode::ReplayedSerial => {
                self.attach_locked(attachment, serial).await?;
                self.ask_in_turn(attachment, request(self.advert(attachment, op, name, serial)?)).await
            }
            result => result,
        }
    }

    /// Sends a request as [`ask`] does, while statements on all links wait for the answer. If
    /// another link is the main one, it waits for a limited time only.
    async fn ask_in_turn(&self, attachment: &Attachment, request: EntityRequest) -> Result<Response, NodeError> {
        tokio::select! {
            answer = ask(attachment, request) => answer,
            () = self.send_path.links.until_unwanted(attachment) => Err(NodeError::Detached("another link is used".into())),
        }
    }

    fn advert(
        &self,
        attachment: &Attachment,
        op: AdvertOp,
        name: Name,
        highest: &mut Option<u64>,
    ) -> Result<Signed<Advert>, NodeError> {
        let serial = highest.unwrap_or(0).saturating_add(1);
        *highest = Some(serial);
        let (entity, switch) = (self.identity.name(), attachment.link.peer().name);
        let (lifetime, box_key) = (LIFETIME, self.identity.box_public());
        Ok(issue(self.identity.key(), &Advert { op, name, entity, switch, serial, lifetime, box_key })?)
    }
}

/// Returns the bit of the lane in [`Advertisement::done`].
fn bit(attachment: &Attachment) -> u8 {
    1 << attachment.lane
}

pub async fn ask(attachment: &Attachment, request: EntityRequest) -> Result<Response, NodeError> {
    Ok(attachment.link.request(&Request::Entity(request)).await?.accepted()?)
}
