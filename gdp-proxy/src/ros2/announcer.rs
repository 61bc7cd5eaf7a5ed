//! Exchanges the announcements of ROS nodes with the other participants of a domain.

use std::sync::Arc;
use std::time::Duration;

use super::nodes::Nodes;
use super::raw::{RawWriter, participant};
use super::raw_reader::RawReader;
use super::sample::RawSample;

/// Time for which changes are gathered before this participant is announced again.
const GATHER: Duration = Duration::from_millis(20);

/// Announces this participant and reads what others announce, until it is cancelled.
pub(super) async fn run(nodes: Arc<Nodes>, mut writer: RawWriter, reader: RawReader) {
    loop {
        tokio::select! {
            () = nodes.changed() => {
                tokio::time::sleep(GATHER).await;
                let Some(sample) = RawSample::parse(nodes.announcement().into()) else { continue };
                if let Err(error) = writer.write(sample, 0).await {
                    tracing::debug!("the nodes of this participant were not announced: {error}");
                    nodes.announce_again();
                }
            }
            arrived = reader.recv() => {
                if let Ok(arrived) = arrived {
                    nodes.take(participant(arrived.writer), &arrived.sample.bytes);
                }
            }
        }
    }
}
