//! Who takes a call, who is told what becomes of it, and that nobody is asked twice.

use std::time::Duration;

use gdp::unstable::Server;
use gdp_ros::call::{CALL, Description, Epoch, FailureCode, Reply, Request};
use gdp_ros::roster::{Dialect, Kind};

use crate::master::{Master, Process, until};
use crate::ros2::Ros2;
use crate::site::{Proxy, Site};
use crate::{FIBONACCI, IN, OUT, graph};

/// ```text
///    rclpy server ── proxy ── switch ──┬── proxy a ──┐
///                                      └── proxy b ──┴── rclpy clients
/// ```
#[tokio::test(flavor = "multi_thread")]
async fn of_two_proxies_in_one_graph_one_takes_each_call_and_the_other_takes_over() {
    let site = Site::start().await;
    let (robot, cloud) = (Ros2::new(), Ros2::new());
    let services = [site.name("service", "/add", "")];
    let _out = site.proxy("robot", &robot.graph(), &services, OUT);
    let mut server = robot.peer("adder", &["serve", "/add"]).await;
    let mut twins = Vec::from(["a", "b"].map(|label| site.proxy(label, &cloud.graph(), &services, IN)));
    let carries = until("one takes calls and the other stands by", async || {
        let carries = twins.iter().position(|proxy| status(proxy) == "up")?;
        twins.iter().any(|proxy| status(proxy).starts_with("standing by for ")).then_some(carries)
    });
    let carries = carries.await;
    let mut client = cloud.begin("client", &["call", "/add", "0", "0", "10"]);
    for sum in 0..10 {
        assert_eq!(client.event("response").await["sum"], sum);
    }
    // A second one would be here before those of the next client.
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert_eq!(asked(&mut server, 10).await, Vec::from_iter(0..10), "each once");

    twins.remove(carries).stop();
    until("the other takes over", async || (status(&twins[0]) == "up").then_some(())).await;
    let mut another = cloud.begin("another", &["call", "/add", "10", "0", "5"]);
    for sum in 10..15 {
        assert_eq!(another.event("response").await["sum"], sum);
    }
    tokio::time::sleep(Duration::from_secs(1)).await;
    cloud.begin("last", &["call", "/add", "15", "0"]).event("response").await;
    assert_eq!(asked(&mut server, 6).await, Vec::from_iter(10..16), "each once");
}

/// Whatever its name: calls under way would end with a change.
#[tokio::test(flavor = "multi_thread")]
async fn who_takes_calls_is_not_disturbed_by_one_that_comes() {
    let site = Site::start().await;
    let (robot, cloud) = (Ros2::new(), Ros2::new());
    let services = [site.name("service", "/light", "std_srvs/srv/SetBool")];
    let _out = site.proxy("robot", &robot.graph(), &services, OUT);
    let mut light = robot.peer("light", &["switch", "/light"]).await;
    let mut labels = ["a", "b"];
    labels.sort_by_key(|label| site.identity(label).name());
    let higher = site.proxy(labels[1], &cloud.graph(), &services, IN);
    let _client = cloud.begin("client", &["set", "/light", "false"]);
    light.event("set").await;
    let lower = site.proxy(labels[0], &cloud.graph(), &services, IN);
    until("the lower one stands by", async || status(&lower).starts_with("standing by for ").then_some(())).await;
    // It would have taken over by then.
    tokio::time::sleep(Duration::from_secs(2)).await;
    let calls = higher.calls();
    let call = calls.first().unwrap();
    assert_eq!((&call["status"], &call["pending"]), (&"up".into(), &1.into()), "{call}");
}

#[tokio::test(flavor = "multi_thread")]
async fn those_who_wait_are_told_when_the_proxy_stops() {
    let site = Site::start().await;
    let (robot, cloud, master) = (Ros2::new(), Ros2::new(), Master::start().await);
    let (services, actions) =
        ([site.name("service", "/light", "std_srvs/srv/SetBool")], [site.name("action", "/fibonacci", FIBONACCI)]);
    let _outs =
        [site.proxy("services", &robot.graph(), &services, OUT), site.proxy("actions", &robot.graph(), &actions, OUT)];
    let of_services = site.proxy("ros1", &graph(&master), &services, IN);
    let of_actions = site.proxy("ros2", &cloud.graph(), &actions, IN);
    let mut light = robot.peer("light", &["switch", "/light"]).await;
    let _server = robot.peer("server", &["compute", "/fibonacci", "0.1"]).await;
    let mut client = master.begin("client", &["call", "/light", "false"]);
    let mut sender = cloud.begin("sender", &["send", "/fibonacci", "10000"]);
    light.event("set").await;
    sender.event("feedback").await;
    of_services.stop();
    let error = client.event("error").await;
    assert!(error["text"].as_str().unwrap().contains("this proxy carries no calls any more"), "{error}");
    of_actions.stop();
    let result = sender.event("result").await;
    assert_eq!((&result["status"], &result["shown"]), (&"aborted".into(), &"aborted".into()));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_has_gone_waits_no_more() {
    let site = Site::start().await;
    let (robot, cloud) = (Ros2::new(), Ros2::new());
    let services = [site.name("service", "/light", "std_srvs/srv/SetBool")];
    let _out = site.proxy("robot", &robot.graph(), &services, OUT);
    let proxy = site.proxy("cloud", &cloud.graph(), &services, IN);
    let mut light = robot.peer("light", &["switch", "/light"]).await;
    let mut client = cloud.begin("client", &["set", "/light", "false"]);
    light.event("set").await;
    let pending = |wanted: u64| {
        let proxy = &proxy;
        async move || (proxy.calls().first()?["pending"] == wanted).then_some(())
    };
    until("it waits", pending(1)).await;
    client.stop().await;
    until("it waits no more", pending(0)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_call_that_fails_takes_no_server_away() {
    let site = Site::start().await;
    let (robot, cloud) = (Master::start().await, Master::start().await);
    let services = [site.name("service", "/lamp", "std_srvs/srv/SetBool")];
    let _out = site.proxy("robot", &graph(&robot), &services, OUT);
    let _in = site.proxy("cloud", &graph(&cloud), &services, IN);
    let (_lamp, _) = robot.peer("lamp", &["hang-up", "/lamp"]).await;
    let error = cloud.begin("unlucky", &["call", "/lamp", "true"]).event("error").await;
    assert!(error["text"].as_str().unwrap().contains("the server failed"), "{error}");
    let response = cloud.begin("lucky", &["call", "/lamp", "true"]).event("response").await;
    assert_eq!(response["success"], true);
    assert!(!site.log("robot").contains("the local server has gone"), "{}", site.log("robot"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_was_started_anew_is_asked_once_more() {
    let site = Site::start().await;
    // A client of ROS 1 is told of a call that fails, and asks no more.
    let cloud = Master::start().await;
    let services = [site.name("service", "/light", "std_srvs/srv/SetBool")];
    let server = site.serve(&services[0]).await;
    let serving = tokio::spawn(serve_anew(server));
    let _in = site.proxy("cloud", &graph(&cloud), &services, IN);
    let response = cloud.begin("client", &["call", "/light", "true"]).event("response").await;
    assert_eq!((&response["success"], &response["message"]), (&true.into(), &"it is on".into()));
    assert_eq!(serving.await.unwrap(), [Epoch(1), Epoch(2)]);
}

/// As a proxy whose server is another one when the first call comes. By which description it was
/// called, when it has answered one.
async fn serve_anew(mut server: Server) -> Vec<Epoch> {
    let (mut now, mut called) = (Epoch(1), Vec::new());
    loop {
        let call = server.recv().await.unwrap();
        let reply = match Request::from_bytes(call.body()).unwrap() {
            Request::Describe => {
                let kind = Kind { dialect: Dialect::Ros2, name: "std_srvs/srv/SetBool".into(), hash: vec![] };
                Reply::Description(now, Description { kind, node: String::new(), definitions: None })
            }
            Request::Call { epoch, .. } => {
                called.push(epoch);
                match called.len() {
                    1 => {
                        now = Epoch(2);
                        Reply::failure(FailureCode::Changed, "")
                    }
                    _ => Reply::Answer((&b"\0\x01\0\0\x01\0\0\0\x09\0\0\0it is on\0"[..]).into()),
                }
            }
            Request::Events { .. } | Request::Cancel(_) => panic!("of a service that one server has"),
        };
        let is_answer = matches!(reply, Reply::Answer(_));
        call.reply(CALL, &reply.to_bytes().unwrap()).await.unwrap();
        if is_answer {
            // Its reply is on its way.
            tokio::time::sleep(Duration::from_secs(2)).await;
            return called;
        }
    }
}

/// The next of so many sums that a server was asked for, sorted.
async fn asked(server: &mut Process, count: usize) -> Vec<i64> {
    let mut sums = Vec::new();
    while sums.len() < count {
        sums.push(server.event("asked").await["sum"].as_i64().unwrap());
    }
    sums.sort();
    sums
}

fn status(proxy: &Proxy) -> String {
    proxy.calls().first().map_or_else(String::new, |call| call["status"].as_str().unwrap().to_owned())
}
