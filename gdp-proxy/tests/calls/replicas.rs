//! Calls that go to several servers at once.

use std::time::Duration;

use gdp::unstable::Server;
use gdp_core::crypto;
use gdp_ros::call::{CALL, Description, Epoch, FailureCode, Reply, Request};
use gdp_ros::roster::{Dialect, Kind};
use gdp_wire::Name;
use serde_json::Value;

use crate::master::{LIMIT, Master, until};
use crate::ros2::Ros2;
use crate::site::{Proxy, Site};
use crate::{IN, OUT, graph};

const SITES: [&str; 3] = ["one", "two", "three"];

/// ```text
///    rospy server, stalled ── proxy ──┐           ┌── proxy ── rospy client, one server
///    rospy server ─────────── proxy ──┼── switch ─┼── proxy ── rospy client, three servers
///    rclpy server ─────────── proxy ──┘           └── proxy ── rclpy client, two servers
/// ```
#[tokio::test(flavor = "multi_thread")]
async fn a_stalled_server_delays_no_call_that_goes_to_others_as_well() {
    let site = Site::start().await;
    let (masters, robot) = ([Master::start().await, Master::start().await], Ros2::new());
    let services = [site.idempotent("/lamp", "std_srvs/srv/SetBool")];
    let servers = [graph(&masters[0]), graph(&masters[1]), robot.graph()];
    let out = [0, 1, 2].map(|i| site.proxy(SITES[i], &servers[i], &services, OUT));
    let (lamp, _) = masters[0].peer("lamp", &["serve", "/lamp"]).await;
    let (_second, _) = masters[1].peer("lamp", &["serve", "/lamp"]).await;
    let _third = robot.peer("lamp", &["switch", "/lamp"]).await;

    let (alone, cloud, ros2) = (Master::start().await, Master::start().await, Ros2::new());
    let client = |prefix, graph: &str, copies| {
        let says = if copies > 1 { format!("{IN}, replicate: {copies}") } else { IN.to_owned() };
        site.proxy(&nearest_to_one(&site, prefix), graph, &services, &says)
    };
    let to_one = client("alone", &graph(&alone), 1);
    let to_three = client("cloud", &graph(&cloud), 3);
    let to_two = client("ros2", &ros2.graph(), 2);
    for proxy in [&to_one, &to_three, &to_two] {
        until("all three can be called", async || (count(proxy, "servers") == 3).then_some(())).await;
    }
    assert_eq!(alone.begin("first", &["call", "/lamp", "true"]).event("response").await["success"], true);
    until("the nearest alone is called", async || (count(&out[0], "calls") == 1).then_some(())).await;
    assert_eq!(count(&to_one, "calls_replicated"), 0);

    lamp.signal(libc::SIGSTOP);
    let mut waiting = alone.begin("waiting", &["call", "/lamp", "true"]);
    until("the stalled one is called", async || (count(&to_one, "pending") == 1).then_some(())).await;
    let mut many = cloud.begin("many", &["call", "/lamp", "true,true,true,true,true"]);
    for _ in 0..5 {
        assert_eq!(many.event("response").await["message"], "it is on");
    }
    for name in ["a", "b"] {
        assert_eq!(ros2.begin(name, &["set", "/lamp", "true"]).event("response").await["success"], true);
    }
    for (proxy, calls) in [(&to_three, 5), (&to_two, 2)] {
        until("each call is answered by another than the nearest", async || {
            let keys = ["calls", "answers", "calls_replicated", "answers_by_other"];
            keys.iter().all(|key| count(proxy, key) == calls).then_some(())
        })
        .await;
        until("each call's copy to the stalled one is cancelled", async || {
            (count(proxy, "copies_cancelled") >= calls && count(proxy, "pending") == 0).then_some(())
        })
        .await;
        assert!(call(proxy)["failures"].as_object().unwrap().values().all(|count| *count == 0), "{}", call(proxy));
    }
    until("its proxy waits for the answer to one call only", async || {
        (count(&out[0], "copies_cancelled") == 7 && count(&out[0], "pending") == 1).then_some(())
    })
    .await;
    let hangs = tokio::time::timeout(Duration::from_secs(1), waiting.event("response")).await;
    assert!(hangs.is_err() && count(&to_one, "pending") == 1, "{hangs:?}");

    lamp.signal(libc::SIGCONT);
    assert_eq!(waiting.event("response").await["success"], true);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failure_counts_only_if_all_servers_fail() {
    let site = Site::start().await;
    let (masters, cloud) = ([Master::start().await, Master::start().await], Master::start().await);
    let services = ["/lamp", "/light"].map(|name| site.idempotent(name, "std_srvs/srv/SetBool"));
    let _out = [0, 1].map(|i| site.proxy(SITES[i], &graph(&masters[i]), &services, OUT));
    let proxy = site.proxy("cloud", &graph(&cloud), &services, &format!("{IN}, replicate: 2"));
    // One of them answers, and the other fails without an answer.
    let (_lamp, _) = masters[0].peer("lamp", &["serve", "/lamp"]).await;
    let (_unlucky, _) = masters[1].peer("unlucky", &["hang-up", "/lamp"]).await;
    // Both fail at false.
    let (_light, _) = masters[0].peer("light", &["serve", "/light"]).await;
    let (_same, _) = masters[1].peer("light", &["serve", "/light"]).await;
    let of = |service: &str, key: &str| {
        let calls = proxy.calls();
        let of_it = calls.iter().find(|call| call["service"] == service);
        of_it.map(|call| call[key].clone()).unwrap_or_default()
    };
    until("both can be called", async || {
        ["/lamp", "/light"].iter().all(|service| of(service, "servers") == 2).then_some(())
    })
    .await;
    let response = cloud.begin("lucky", &["call", "/lamp", "true"]).event("response").await;
    assert_eq!((&response["success"], &response["message"]), (&true.into(), &"it is on".into()));
    let error = cloud.begin("dark", &["call", "/light", "false"]).event("error").await;
    assert!(error["text"].as_str().unwrap().contains("it stays on"), "{error}");
    let counted = |service| (of(service, "answers"), of(service, "failures")["refused"].clone());
    until("both are counted", async || {
        let both = (counted("/lamp"), counted("/light"));
        (both == ((1.into(), 0.into()), (0.into(), 1.into()))).then_some(())
    })
    .await;
}

/// Two sites of one owner expose both services, and one of these is idempotent.
#[tokio::test(flavor = "multi_thread")]
async fn of_imported_services_the_idempotent_ones_are_replicated() {
    let site = Site::start().await;
    let (masters, cloud) = ([Master::start().await, Master::start().await], Master::start().await);
    let expose = "services: [/lamp, /light], idempotent: [/lamp]";
    let (out, far) = site.by_pattern("one", "cloud", expose, "services: [/**], prefix: /far, replicate: 2");
    for file in ["owner.pem", "one.card"] {
        std::fs::copy(site.folder("one").join(file), site.folder("two").join(file)).unwrap();
    }
    let _out = [0, 1].map(|i| site.begin(SITES[i], &graph(&masters[i]), &out));
    let mut servers = Vec::new();
    for master in &masters {
        for name in ["lamp", "light"] {
            servers.push(master.peer(name, &["serve", &format!("/{name}")]).await);
        }
    }
    let proxy = site.begin("cloud", &graph(&cloud), &far);
    let of = |service: &str, key: &str| {
        let calls = proxy.calls();
        calls.iter().find(|call| call["service"] == service).and_then(|call| call[key].as_u64())
    };
    for (name, replicated) in [("/far/lamp", 1), ("/far/light", 0)] {
        until("both can be called", async || (of(name, "servers") == Some(2)).then_some(())).await;
        let response = cloud.begin(&name[5..], &["call", name, "true"]).event("response").await;
        assert_eq!(response["success"], true);
        until("it is counted", async || (of(name, "answers") == Some(1)).then_some(())).await;
        assert_eq!(of(name, "calls_replicated"), Some(replicated), "{name}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_is_not_idempotent_is_not_called_twice() {
    let site = Site::start().await;
    let cloud = Master::start().await;
    let services = [site.name("service", "/lamp", "std_srvs/srv/SetBool")];
    let _proxy = site.proxy("cloud", &graph(&cloud), &services, &format!("{IN}, replicate: 2"));
    let refusal = "services[0].replicate: the owner has not marked the service";
    until("it does not start", async || site.log("cloud").contains(refusal).then_some(())).await;
}

/// Its description does not arrive while the client waits for it, because the other answers first.
#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_has_changed_is_called_again_although_another_answers_first() {
    let site = Site::start().await;
    let cloud = Master::start().await;
    let services = [site.idempotent("/light", "std_srvs/srv/SetBool")];
    let changing = tokio::spawn(change(site.serve(&services[0]).await));
    let answering = tokio::spawn(answer_late(site.serve(&services[0]).await));
    let proxy = site.proxy("cloud", &graph(&cloud), &services, &format!("{IN}, replicate: 2"));
    until("both can be called", async || (count(&proxy, "servers") == 2).then_some(())).await;
    let many = ["true"; 100].join(",");
    let mut client = cloud.begin("client", &["call", "/light", &many]);
    assert_eq!(client.event("response").await["message"], "it is on");
    assert_eq!(tokio::time::timeout(LIMIT, changing).await.unwrap().unwrap(), Epoch(2));
    answering.abort();
}

/// After the other's failure, and before its description.
const LATE: Duration = Duration::from_millis(300);

/// As a proxy whose server is another one when the first call comes. Returns the description by
/// which it is called then.
async fn change(mut server: Server) -> Epoch {
    let mut now = Epoch(1);
    loop {
        let call = server.recv().await.unwrap();
        let reply = match Request::from_bytes(call.body()).unwrap() {
            Request::Describe => {
                if now == Epoch(2) {
                    tokio::time::sleep(2 * LATE).await;
                }
                description(now)
            }
            Request::Call { epoch: Epoch(1), .. } => {
                now = Epoch(2);
                Reply::failure(FailureCode::Changed, "")
            }
            Request::Call { epoch, .. } => return epoch,
            Request::Cancel(_) => continue,
            Request::Events { .. } => panic!("of a service"),
        };
        call.reply(CALL, &reply.to_bytes().unwrap()).await.unwrap();
    }
}

async fn answer_late(mut server: Server) {
    loop {
        let call = server.recv().await.unwrap();
        let reply = match Request::from_bytes(call.body()).unwrap() {
            Request::Describe => description(Epoch(1)),
            Request::Call { .. } => {
                tokio::time::sleep(LATE).await;
                Reply::Answer((&b"\0\x01\0\0\x01\0\0\0\x09\0\0\0it is on\0"[..]).into())
            }
            Request::Cancel(_) => continue,
            Request::Events { .. } => panic!("of a service"),
        };
        call.reply(CALL, &reply.to_bytes().unwrap()).await.unwrap();
    }
}

fn description(epoch: Epoch) -> Reply {
    let kind = Kind { dialect: Dialect::Ros2, name: "std_srvs/srv/SetBool".into(), hash: vec![] };
    Reply::Description(epoch, Description { kind, node: String::new(), definitions: None })
}

/// The label of a proxy to which the first site is the nearest. All are at one switch, so that a
/// hash decides.
fn nearest_to_one(site: &Site, prefix: &str) -> String {
    let name = |label: &str| site.identity(label).name();
    let servers: Vec<Name> = SITES.iter().map(|label| name(label)).collect();
    let mut labels = (0..).map(|i| format!("{prefix}{i}"));
    let is_nearest = |label: &String| {
        let client = name(label);
        let tie = |server: &&Name| crypto::sha256(&[client.as_bytes(), server.as_bytes()]);
        servers.iter().min_by_key(tie) == servers.first()
    };
    labels.find(is_nearest).unwrap()
}

/// What the statistics say of a proxy's only service.
fn call(proxy: &Proxy) -> Value {
    proxy.calls().first().cloned().unwrap_or_default()
}

fn count(proxy: &Proxy, key: &str) -> u64 {
    call(proxy)[key].as_u64().unwrap_or_default()
}
