//! What a switch, a RIB, a reader or a stolen robot can do that is against everybody else: each test lets one of them do it,
//! and says what was delivered and what was counted under which reason. `docs/security.md` refers to the tests by their names.
//! No root: see [`evil`].

mod evil;
#[path = "malicious/flood.rs"]
mod flood;
#[path = "malicious/reader.rs"]
mod reader;
#[path = "malicious/rib.rs"]
mod rib;
#[path = "malicious/switch.rs"]
mod switch;

use anyhow::Result;
use gdp::Identity;
use gdp::node::{PublishOptions, SubscribeOptions};
use gdp::seal::Encoding;

use evil::{Owner, Switch, node};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_is_dropped_while_everybody_is_honest() -> Result<()> {
    let (switch, owner) = (Switch::start()?, Owner::new("/chatter")?);
    let (robot, cloud) = (Identity::generate("proxy")?, Identity::generate("proxy")?);
    let (robot, cloud) = (node(&switch, &robot).await?, node(&switch, &cloud).await?);
    let mut subscription = owner.subscribe(&cloud, SubscribeOptions::best_effort()).await?;
    let mut publisher = owner.publish(&robot, PublishOptions::best_effort()).await?;
    for body in [vec![], vec![1; 100], vec![2; 100_000]] {
        publisher.send(Encoding::Bytes, &body).await?;
        let message = tokio::time::timeout(evil::SOON, subscription.recv()).await?.unwrap();
        assert_eq!((&message.body[..], message.writer), (&body[..], robot.name()));
    }
    assert!(cloud.counters().drops.is_empty(), "{:?}", cloud.counters());
    Ok(())
}
