//! Topics that cross by pattern, and a configuration that changes while its proxy runs.

use gdp_tests::dds_domain::lease;
use std::fs;
use std::time::Duration;

use gdp_e2e::seal::Encoding;
use gdp_proxy::automatic::choice::GRACE;
use gdp_proxy::ros2::{Domain, TopicName, TypeName};

use super::master::Master;
use super::site::Site;
use super::{RELIABLE, cdr, graph, until, within};

#[tokio::test(flavor = "multi_thread")]
async fn what_matches_crosses_while_it_is_published_and_deny_wins() {
    let site = Site::start().await;
    let (here, there) = (lease(), lease());
    let (expose, import) = by_pattern(&site);
    let _robot = site.begin("robot", &format!("{{domain_id: {here}}}"), &expose);
    let _cloud = site.begin("cloud", &format!("{{domain_id: {there}}}"), &import);

    let (camera, graph_observer) =
        (Domain::join(here, "camera").unwrap(), Domain::join(there, "graph_observer").unwrap());
    let kind = TypeName::parse("std_msgs/msg/String").unwrap();
    let topic = |name: &str| TopicName::parse(name).unwrap();
    let writer = |name: &str| camera.writer(&topic(name), &kind, &RELIABLE).unwrap();
    let _others = [writer("/camera/secret"), writer("/other")];
    let mut image = writer("/camera/image");
    let reader = graph_observer.reader(&topic("/far/r1/camera/image"), &kind, &RELIABLE).unwrap();
    let heard = within("an image elsewhere", async {
        loop {
            tokio::select! {
                heard = reader.recv() => break heard,
                () = tokio::time::sleep(Duration::from_millis(100)) => image.write(cdr("light"), 0).await.unwrap(),
            }
        }
    });
    assert_eq!(text(&heard.await.unwrap().sample.bytes), "light");
    // And nothing else.
    let shown = || site.carried("robot") == ["/camera/image"] && site.carried("cloud") == ["/far/r1/camera/image"];
    until("it is shown at both", shown).await;

    drop(image);
    until("the topic is gone at both", || site.carried("robot").is_empty() && site.carried("cloud").is_empty()).await;
    // Under the same name as before.
    let mut image = writer("/camera/image");
    let back = within("an image after that", async {
        loop {
            tokio::select! {
                heard = reader.recv() => break heard,
                () = tokio::time::sleep(Duration::from_millis(100)) => image.write(cdr("again"), 0).await.unwrap(),
            }
        }
    });
    assert_eq!(text(&back.await.unwrap().sample.bytes), "again");
    until("it is shown at both again", shown).await;
    camera.leave().await;
    graph_observer.leave().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_rospy_publishes_crosses_by_pattern_and_outlives_its_master() {
    let site = Site::start().await;
    let (mut here, there) = (Master::start().await, Master::start().await);
    let (expose, import) = by_pattern(&site);
    let _robot = site.begin("robot", &graph(&here), &expose);
    let _cloud = site.begin("cloud", &graph(&there), &import);
    let mut talker = here.begin("talker", &["publish", "/camera/image", "light"]);
    let _others = [("secret", "/camera/secret"), ("other", "/other")]
        .map(|(name, topic)| here.begin(name, &["publish", topic, "nothing"]));
    let shown = |names: &[&str]| {
        let [near, far] = ["/camera/", "/far/r1/camera/"]
            .map(|folder| names.iter().map(|name| format!("{folder}{name}")).collect::<Vec<_>>());
        site.carried("robot") == near && site.carried("cloud") == far
    };
    until("it is shown at both", || shown(&["image"])).await;
    let (mut listener, _) = there.peer("listener", &["listen", "/far/r1/camera/image"]).await;
    let heard = listener.event("message").await;
    assert!(heard["data"].as_str().unwrap().starts_with("light "), "{heard}");

    // The new one knows nobody, and rospy does not tell it.
    here.kill();
    here.restart().await;
    let _late = here.begin("late", &["publish", "/camera/late", "late"]);
    until("what comes now crosses as well", || shown(&["image", "late"])).await;
    tokio::time::sleep(GRACE + Duration::from_secs(2)).await;
    assert!(shown(&["image", "late"]), "{:?} {:?}", site.carried("robot"), site.carried("cloud"));
    let (mut fresh, _) = there.peer("fresh", &["listen", "/far/r1/camera/image"]).await;
    fresh.event("message").await;

    talker.stop().await;
    until("it is gone at both", || shown(&["late"])).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_changed_configuration_disturbs_no_topic_that_is_the_same() {
    let site = Site::start().await;
    let domain = lease();
    let graph = format!("{{domain_id: {domain}}}");
    let topics = ["/steady", "/second"].map(|topic| site.topic(topic, "std_msgs/msg/String"));
    let [steady, second] = [0, 1].map(|i| site.give("robot", i, &topics[i], "direction: out"));
    let proxy = site.begin("robot", &graph, &format!("topics:\n{steady}"));
    let mut subscription = site.subscribe(&topics[0]).await;

    let participant = Domain::join(domain, "steady").unwrap();
    let kind = TypeName::parse("std_msgs/msg/String").unwrap();
    let writer = |topic: &str| participant.writer(&TopicName::parse(topic).unwrap(), &kind, &RELIABLE).unwrap();
    let (mut writer, _second) = (writer("/steady"), writer("/second"));
    let talking = tokio::spawn(async move {
        for number in 0u32.. {
            writer.write(cdr(&number.to_string()), 0).await.unwrap();
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    });
    let (count, counted) = tokio::sync::watch::channel((0, None));
    let counting = tokio::spawn(async move {
        let (mut last, mut of) = (None, None);
        while let Some(message) = subscription.recv().await {
            if message.encoding != Encoding::Cdr {
                continue;
            }
            let number: u32 = text(&message.body).parse().unwrap();
            assert!(last.is_none_or(|last| number == last + 1), "{number} after {last:?}");
            assert!(of.is_none_or(|of| of == message.session), "another session");
            (last, of) = (Some(number), Some(message.session));
            count.send_replace((number, of));
        }
    });
    let more = || {
        let (seen, mut counted) = (counted.borrow().0, counted.clone());
        async move {
            let next = counted.wait_for(|(number, _)| *number > seen + 3);
            within("more messages", next).await.unwrap();
        }
    };
    more().await;

    site.configure("robot", &graph, &format!("topics:\n{steady}{second}"));
    proxy.signal(libc::SIGHUP);
    until("the second topic is carried", || site.carried("robot").len() == 2).await;
    more().await;

    let log = site.folder("robot").join("log");
    let says = |what: &str| fs::read_to_string(&log).unwrap().contains(what);
    site.configure("robot", &graph, &format!("topics:\n{steady}{}", second.replace("direction", "dirction")));
    until("the mistake is said", || says("not taken") && says("did you mean `direction`? at line 7")).await;
    site.configure("robot", &format!("{{domain_id: {}}}", lease()), &format!("topics:\n{steady}"));
    until("what cannot change is said", || says("graphs.a: cannot change while the proxy runs")).await;
    assert_eq!(site.carried("robot").len(), 2);

    site.configure("robot", &graph, &format!("topics:\n{steady}"));
    until("the second topic is not carried", || site.carried("robot") == ["/steady"]).await;
    more().await;

    let [cert, away] = ["1.ad", "away"].map(|file| site.folder("robot").join(file));
    fs::rename(&cert, &away).unwrap();
    site.configure("robot", &graph, &format!("topics:\n{steady}{second}"));
    until("what is missing is said", || says("topics[1].cert: ")).await;
    fs::rename(&away, &cert).unwrap();
    until("the second topic is carried once the file is there", || site.carried("robot").len() == 2).await;
    more().await;
    assert!(!counting.is_finished());
    talking.abort();
    counting.abort();
    participant.leave().await;
}

/// What the configurations of `robot` and `cloud` say: of what is in `/camera` there, all but a
/// secret comes here, in `/far/r1`.
fn by_pattern(site: &Site) -> (String, String) {
    let expose = "topics: [/camera/**], deny: [/camera/secret], remap: [{from: /camera, to: /r1/camera}]";
    site.by_pattern("robot", "cloud", expose, "topics: [/**], prefix: /far")
}

/// Of a `std_msgs/msg/String`; padding may follow.
fn text(cdr: &[u8]) -> &str {
    let length = u32::from_le_bytes(cdr[4..8].try_into().unwrap()) as usize;
    std::str::from_utf8(&cdr[8..8 + length - 1]).unwrap()
}
