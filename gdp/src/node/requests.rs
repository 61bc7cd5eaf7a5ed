//! What the switch asks of the node, and what the node brings to the RIB besides statements.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use tokio::sync::mpsc;

use super::attachment::Attachment;
use super::command::RibUpdate;
use super::error::NodeError;
use super::pause::{BACKOFF, wait};
use super::state::State;
use gdp_link::link::Responder;
use gdp_proto::control::{Refusal, RefusalCode, Request, Response};

/// How long the node tries to attach again over the link it has; the switch waits a little longer
/// for its answer.
const REATTACH: Duration = Duration::from_secs(4);

/// Answers what the switch asks.
pub async fn answer(state: Arc<State>, attachment: Arc<Attachment>, request: Request, responder: Responder) {
    let response = match request {
        Request::Peers(push) if push.entity == state.identity.name() => {
            match state.take_peers(push.name, push.role, &push.peers) {
                Some(Ok(())) => Response::Done,
                Some(Err(error)) => Refusal::new(RefusalCode::Malformed, error.to_string()).into(),
                None => Refusal::new(RefusalCode::NotFound, format!("no {} of {} here", push.role, push.name)).into(),
            }
        }
        Request::Costs(costs) => {
            attachment.reported_costs.store(true, Ordering::Relaxed);
            state.set_costs(attachment.lane, costs);
            Response::Done
        }
        // The RIB has forgotten what was stated, as after a restart. Frames go on meanwhile.
        Request::Detach { entity, .. } if entity == state.identity.name() => {
            match tokio::time::timeout(REATTACH, attach_again(&state, &attachment)).await {
                Ok(Ok(())) => Response::Done,
                Ok(Err(error)) => Refusal::new(RefusalCode::NotAttached, error.to_string()).into(),
                Err(_) => Refusal::new(RefusalCode::Unreachable, "the RIB did not answer").into(),
            }
        }
        Request::Papers(credentials) => match state.home.take_credentials(&attachment.link, *credentials) {
            Ok(()) => Response::Done,
            Err(error) => Refusal::new(RefusalCode::NotEntitled, error.to_string()).into(),
        },
        Request::DomainRevoked { proof, revocation } => match state.home.take_revocation(&proof, &revocation) {
            Ok(news) => {
                news.iter().for_each(|claims| state.domain_revoked(claims));
                Response::Done
            }
            Err(error) => Refusal::new(RefusalCode::ReplayedSerial, error.to_string()).into(),
        },
        _ => Refusal::new(
            RefusalCode::Unsupported,
            "an endpoint is told about its counterparts, its attachment and what paths cost only",
        )
        .into(),
    };
    let _ = responder.respond(response).await;
}

/// Attaches over the link there is, and has everything stated again. The switch may only be about
/// to find its way to the RIB.
async fn attach_again(state: &State, attachment: &Attachment) -> Result<(), NodeError> {
    let mut backoff = BACKOFF;
    while let Err(error) = state.attach(attachment).await {
        if !error.may_pass() || attachment.link.close_reason().is_some() {
            return Err(error);
        }
        wait(&mut backoff).await;
    }
    state.send_path.links.slot(attachment).unstated.notify_one();
    Ok(())
}

/// Has what the rest of the node says done over the main link, once there is one.
pub async fn update_rib(state: &Arc<State>, mut updates: mpsc::UnboundedReceiver<RibUpdate>) {
    while let Some(update) = updates.recv().await {
        let attachment = loop {
            match state.send_path.links.attached().await {
                Ok(attachment) => break attachment,
                Err(NodeError::Closed) => return,
                Err(_) => {}
            }
        };
        tokio::spawn(handle(state.clone(), attachment, update));
    }
}

async fn handle(state: Arc<State>, attachment: Arc<Attachment>, update: RibUpdate) {
    match update {
        RibUpdate::Withdraw { name, stated } => {
            let mut backoff = BACKOFF;
            while let Err(error) = state.state_withdrawal(&attachment, name, stated).await {
                match error {
                    // It went with an attachment that ended.
                    NodeError::Refused(refusal) if refusal.code == RefusalCode::NotFound => return,
                    // What was stated may outlive the link: that is for the next one to tell.
                    NodeError::Detached(_) => return state.withdraw_later(name, stated),
                    _ if attachment.link.close_reason().is_some() => return state.withdraw_later(name, stated),
                    error => tracing::warn!(%name, %error, "could not be withdrawn; trying again"),
                }
                wait(&mut backoff).await;
            }
        }
        RibUpdate::Revoke { proof, revocation } => {
            if let Err(error) = state.pass_on(&attachment, proof, revocation).await {
                tracing::warn!(%error, "the RIB does not know a revocation, and does not take it");
            }
        }
    }
}
