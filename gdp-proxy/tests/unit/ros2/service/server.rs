//! Unit tests of `ros2::service::server`.

use futures::FutureExt;

use super::*;

#[tokio::test]
async fn a_client_ends_once_it_is_matched_no_more() {
    let [writer, other] = [1, 2].map(|number| GUID::from_bytes([number; 16]));
    let (shown, writers) = watch::channel(Arc::new(Writers::from([other])));
    let mut client = ClientLife { writer, writers, is_matched: false };
    assert_eq!(client.ends().now_or_never(), None, "it is not shown yet");
    shown.send_replace(Arc::new(Writers::from([writer, other])));
    assert_eq!(client.ends().now_or_never(), None);
    shown.send_replace(Arc::new(Writers::from([other])));
    client.ends().await;
}
