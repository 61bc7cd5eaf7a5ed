//! Attacks that a switch, a RIB, a reader or a stolen robot can make on the others. Each test lets
//! one of them attack, and checks the deliveries and the drop reasons. `docs/security.md` refers to
//! the tests by their names. The tests need no root: see [`crate::evil`].

mod flood;
mod reader;
mod rib;
mod services;
mod switch;

use std::collections::BTreeSet;
use std::path::Path;

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

/// The security model depends on its tests: those that it names must exist.
#[test]
fn every_test_that_the_security_model_names_exists() -> Result<()> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut functions = BTreeSet::new();
    for folder in ["crates", "gdp", "gdp-ctl", "tests"] {
        collect_functions(&root.join(folder), &mut functions)?;
    }
    let model = std::fs::read_to_string(root.join("docs/security.md"))?;
    let quoted = model.split('`').skip(1).step_by(2);
    // Skips paths, commands and types.
    let names = quoted.filter(|name| name.contains('_') && !name.contains(['/', '.', ' ']));
    let mut count = 0;
    for name in names {
        let exists = match name.strip_suffix('…') {
            Some(beginning) => functions.iter().any(|function| function.starts_with(beginning)),
            None => functions.contains(name),
        };
        assert!(exists, "docs/security.md names {name}, which is no test");
        count += 1;
    }
    assert!(count > 50, "{count} names");
    Ok(())
}

fn collect_functions(folder: &Path, functions: &mut BTreeSet<String>) -> Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            collect_functions(&path, functions)?;
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let text = std::fs::read_to_string(&path)?;
            let names =
                text.lines().filter_map(|line| line.trim_start().trim_start_matches("async ").strip_prefix("fn "));
            functions.extend(names.filter_map(|name| name.split(['(', '<']).next()).map(str::to_owned));
        }
    }
    Ok(())
}
