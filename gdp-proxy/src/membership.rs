//! The proxy's membership of a trust domain: read again when its files change, and shown to the switches without new links.

use std::time::Duration;

use gdp::node::Node;
use gdp_core::domain::{PaperFiles, Stamps};

/// How often the files are looked at.
const LOOK: Duration = Duration::from_secs(1);

/// Keeps the node's papers those of the files, for ever; without files it does nothing, for ever. `seen`: what the files were like when
/// the node got its papers.
pub async fn keep_papers(node: &Node, files: Option<(&PaperFiles, Stamps)>) -> std::convert::Infallible {
    let Some((files, mut seen)) = files else { return std::future::pending().await };
    loop {
        tokio::time::sleep(LOOK).await;
        if !files.changed(&mut seen) {
            continue;
        }
        let renewed = match files.load() {
            Ok(papers) => node.renew_papers(papers).await.map_err(|error| error.to_string()),
            Err(error) => Err(error.to_string()),
        };
        match renewed {
            Ok(()) => tracing::info!("took a renewed membership"),
            Err(error) => {
                tracing::error!("the renewed membership is not taken, what was there goes on to count: {error}")
            }
        }
    }
}
