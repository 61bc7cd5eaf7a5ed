//! Processes the switch's requests to the node, and sends updates other than statements to the RIB.

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

/// Time for which the node retries to attach over the existing link. The switch waits slightly
/// longer for its answer.
const REATTACH: Duration = Duration::from_secs(4);

/// Answers a request of the switch.
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
        // The RIB has lost the node's statements, for example after a restart. Frames continue
        // meanwhile.
        Request::Detach { entity, .. } if entity == state.identity.name() => {
            match tokio::time::timeout(REATTACH, attach_again(&state, &attachment)).await {
                Ok(Ok(())) => Response::Done,
                Ok(Err(error)) => Refusal::new(RefusalCode::NotAttached, error.to_string()).into(),
                Err(_) => Refusal::new(RefusalCode::Unreachable, "the RIB did not answer").into(),
            }
        }
        Request::Credentials(credentials) => match state.home.take_credentials(&attachment.link, *credentials) {
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

/// Attaches over the existing link and repeats all statements. The switch may not have its route to
/// the RIB yet.
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

/// Sends updates from the rest of the node to the RIB over the main link, once it is up.
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
                    // The statement was removed with an earlier attachment.
                    NodeError::Refused(refusal) if refusal.code == RefusalCode::NotFound => return,
                    // The statement may outlive the link; the withdrawal is sent over the next one.
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
