//! Actions of ROS 1, which are topics: a client of actionlib finds its server at another master.

use super::graph;
use super::master::{Master, Process};
use super::site::Site;

/// What actionlib's `GoalStatus` calls it.
const SUCCEEDED: u64 = 3;

#[tokio::test(flavor = "multi_thread")]
async fn a_client_finds_a_server_elsewhere_and_one_that_takes_its_place() {
    let site = Site::start().await;
    let (here, there) = (Master::start().await, Master::start().await);
    let (out, taken) = site.by_pattern("robot", "cloud", "topics: [/dock/*]", "topics: [/dock/*]");
    let (back, given) = site.by_pattern("cloud", "robot", "topics: [/dock/*]", "topics: [/dock/*]");
    let _robot = site.begin("robot", &graph(&here), &format!("{out}{given}"));
    let _cloud = site.begin("cloud", &graph(&there), &format!("{back}{taken}"));

    let (mut server, _) = here.peer("server", &["act", "/dock"]).await;
    succeed(&mut there.begin("first", &["ask", "/dock", "5"]), 5).await;
    // Its successor publishes while the counterpart of what it published may still be there.
    server.kill();
    let (_server, _) = here.peer("server", &["act", "/dock"]).await;
    succeed(&mut there.begin("second", &["ask", "/dock", "7"]), 7).await;
}

async fn succeed(client: &mut Process, goal: u64) {
    assert_eq!(client.event("server").await["found"], true);
    client.event("feedback").await;
    let result = client.event("result").await;
    assert_eq!((&result["state"], &result["result"]), (&SUCCEEDED.into(), &(2 * goal).into()), "{result}");
}
