//! Attacks that a switch, a RIB, a reader or a stolen robot can make on the others. Each test lets
//! one of them attack, and checks the deliveries and the drop reasons. `docs/security.md` refers to
//! the tests by their names. The tests need no root: see [`crate::evil`].

mod flood;
mod reader;
mod rib;
mod services;
mod switch;

use anyhow::Result;
use gdp::unstable::{PublishOptions, SubscribeOptions};
use gdp_core::identity::Identity;
use gdp_e2e::seal::Encoding;

use crate::evil::{Owner, Switch, node};
use gdp_tests::wait::TIMEOUT;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_is_refused_while_everybody_is_honest() -> Result<()> {
    let (switch, owner) = (Switch::start()?, Owner::new("/chatter")?);
    let (robot, cloud) = (Identity::generate("proxy")?, Identity::generate("proxy")?);
    let (robot, cloud) = (node(&switch, &robot).await?, node(&switch, &cloud).await?);
    let mut subscription = owner.subscribe(&cloud, SubscribeOptions::best_effort()).await?;
    let mut publisher = owner.publish(&robot, PublishOptions::best_effort()).await?;
    for body in [vec![], vec![1; 100], vec![2; 100_000]] {
        publisher.send(Encoding::Bytes, &body).await?;
        let message = tokio::time::timeout(TIMEOUT, subscription.recv()).await?.unwrap();
        assert_eq!((&message.body[..], message.writer), (&body[..], robot.name()));
    }
    // Except for frames that were requested again and then arrived late.
    let drops = cloud.counters().drops;
    assert!(drops.keys().all(|reason| *reason == "seal_duplicate"), "{drops:?}");
    Ok(())
}
