//! The end of an endpoint's attachment.

use std::sync::Arc;

use gdp_proto::control::Response;
use gdp_wire::Name;

use super::daemon::{Daemon, SerializedTask};

/// Ends the attachment of an endpoint without a link. An entity that is back on another link states
/// again what still holds.
pub async fn detach_lost(daemon: Arc<Daemon>, entity: Name) {
    let detach = async {
        let is_lost = {
            let switch = &daemon.core().switch;
            switch.attached.contains(&entity) && switch.link_to(&entity).is_none() && !switch.stale.keeps(&entity)
        };
        if is_lost && let Response::Refused(refusal) = daemon.answer(|core| core.detach(entity)).await {
            tracing::warn!(%refusal, "the RIB could not be told of a lost attachment; reporting in full");
            daemon.report_in_full();
        }
    };
    daemon.in_turn(SerializedTask::Entity(entity), detach).await;
}
