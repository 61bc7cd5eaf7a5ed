//! What the tests of the node share: a master with rospy nodes, and short ways to what is asked of
//! both.

use bytes::Bytes;
use gdp_ros1::{MasterState, MessageType, Node, Subscription};
use tokio::time::timeout;

pub use crate::master::{LIMIT, Master, until};

/// Waits until the master has taken everything.
pub async fn registered(node: &Node) {
    let mut status = node.status();
    let done = status.wait_for(|status| status.master == MasterState::Reached && status.pending == 0);
    drop(timeout(LIMIT, done).await.expect("registered in time").expect("the node is there"));
}

/// The next message, as text.
pub async fn next_text(subscription: &mut Subscription) -> (String, String) {
    let message = timeout(LIMIT, subscription.next()).await.expect("a message in time").expect("the node is there");
    let (length, text) = message.data.split_at(4);
    assert_eq!(u32::from_le_bytes(length.try_into().unwrap()) as usize, text.len());
    (String::from_utf8(text.to_vec()).unwrap(), message.publisher.caller_id.clone())
}

/// `std_msgs/String`.
pub fn string_type() -> MessageType {
    let [name, md5sum, definition] = ["std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data\n"];
    MessageType { name: name.to_owned(), md5sum: md5sum.to_owned(), definition: definition.to_owned() }
}

/// A `std_msgs/String`, or a string in any message.
pub fn string(text: &str) -> Bytes {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat().into()
}
