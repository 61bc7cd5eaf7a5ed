//! The proxy's membership of a trust domain. The proxy reads the membership files again when they
//! change, and presents the new membership to the switches over the existing links.

use gdp::Node;
use gdp_core::domain::CredentialFiles;
use gdp_util::file_watch::FileSet;

/// Keeps the node's credentials equal to the files, forever. Without files it does nothing,
/// forever. `watched` has the same files, and was created before the node's credentials were read.
pub async fn store_credentials(node: &Node, files: Option<(&CredentialFiles, FileSet)>) -> std::convert::Infallible {
    let Some((files, mut watched)) = files else { return std::future::pending().await };
    loop {
        watched.changed().await;
        let renewed = match files.load() {
            Ok(credentials) => node.renew_credentials(credentials).await.map_err(|error| error.to_string()),
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
