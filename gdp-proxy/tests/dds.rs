//! Two participants in one process, over loopback: no root, no fabric, no other vendor (those are
//! in the workspace's `tests`). RustDDS finds participants of the same host by unicast to
//! 127.0.0.1, so loopback multicast is not needed.

use std::collections::HashSet;
use std::pin::pin;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, LazyLock, Mutex};
use std::time::Duration;

use bytes::Bytes;
use gdp_proxy::config::Graphs;
use gdp_proxy::graph::{self, ActionCaller, Arrived, Event, Graph, Peer, Reader};
use gdp_proxy::ros2::{Action, Domain, Qos, Range, RawReader, RawSample, RawWriter, TopicName, TypeName};
use gdp_ros::call;
use gdp_ros::roster::Offer;
use gdp_ros::types::Types;
use gdp_tests::dds_domain::lease;

const RELIABLE: Offer = Offer::DEFAULT;
const LATCHED: Offer = Offer { transient_local: true, ..RELIABLE };

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn publishers_are_told_apart_and_each_is_heard_once() {
    let (here, there) = (join(), graphs().await);
    let topic = topic("publishers");
    let graph = &there["a"];
    let mut reader = graph.reader(&topic, None, None).unwrap();
    let best_effort = Offer { reliable: false, deadline_ns: 2_000_000_000, ..RELIABLE };
    let mut latching = here.writer(&topic, &kind(), &Offer { depth: 1, ..LATCHED }).unwrap();
    latching.write(sample([0, 1, 0, 0], 8), 0).await.unwrap();
    let mut lively = here.writer(&topic, &kind(), &best_effort).unwrap();

    let mut offers = Vec::new();
    let (mut from_latching, mut from_lively) = (None, None);
    within("both are heard", async {
        while from_latching.is_none() || from_lively.is_none() {
            lively.write(sample([0, 1, 0, 0], 16), 0).await.unwrap();
            let Ok(event) = tokio::time::timeout(Duration::from_millis(20), reader.next()).await else { continue };
            match event.unwrap() {
                Event::Joined { key, kind, offers: of, .. } => {
                    assert_eq!(kind.name, "some_msgs/msg/Unheard");
                    offers.push((key, of));
                }
                Event::Message(Arrived { from: Some(key), bytes, .. }) => match bytes.len() {
                    12 => assert_eq!(from_latching.replace(key), None, "once"),
                    _ => from_lively = Some(key),
                },
                Event::Message(_) => panic!("of nobody"),
                Event::Incompatible { why, .. } => panic!("nothing is asked for: {why}"),
                Event::Left(_) | Event::Liveliness { .. } | Event::Unreadable(_) => panic!("not yet"),
            }
        }
    })
    .await;
    let of = |from| offers.iter().find(|(key, _)| Some(*key) == from).map(|(_, offers)| *offers);
    assert_eq!(of(from_latching), Some(Offer { depth: 1, ..LATCHED }));
    assert_eq!(of(from_lively), Some(best_effort));

    drop(lively);
    assert_eq!(within("it is seen to go", gone(&mut reader)).await, from_lively);
    here.leave().await;
    assert_eq!(within("all are seen to go", gone(&mut reader)).await, from_latching);
    drop(reader);
    graph::leave(there).await;
}

/// What a participant says as it leaves is the last that it sends, and nothing repeats it: without
/// it, others wait for a minute's lease to run out.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_leaves_is_seen_to_go_at_once() {
    let there = graphs().await;
    let topic = topic("leaving");
    let mut reader = there["a"].reader(&topic, None, None).unwrap();
    for i in 0..20 {
        let here = join();
        let mut writer = here.writer(&topic, &kind(), &LATCHED).unwrap();
        writer.write(sample([0, 1, 0, 0], 8), 0).await.unwrap();
        within("it is heard", async { while !matches!(reader.next().await.unwrap(), Event::Message(_)) {} }).await;
        here.leave().await;
        let left = tokio::time::timeout(Duration::from_secs(20), gone(&mut reader)).await;
        assert!(left.is_ok(), "participant {i} is not seen to go");
    }
    drop(reader);
    graph::leave(there).await;
}

/// The next publisher that leaves.
async fn gone(reader: &mut Reader<'_>) -> Option<graph::Key> {
    loop {
        if let Event::Left(key) = reader.next().await.unwrap() {
            return Some(key);
        }
    }
}

async fn graphs() -> graph::All {
    let graphs: Graphs = serde_json::from_str(&format!(r#"{{"a": {{"domain_id": {}}}}}"#, domain_id())).unwrap();
    let mut joined = graph::All::new();
    graph::join(&mut joined, &graphs, "gdp_proxy_test").await.unwrap();
    joined
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_action_is_called_once_its_feedback_would_arrive() {
    let (there, here) = (join(), graphs().await);
    let (name, kind) = (topic("action"), TypeName::parse("some_msgs/action/Unheard").unwrap());
    let parts = Action::new(&name, &kind).unwrap();
    let servers =
        [&parts.send_goal, &parts.cancel_goal, &parts.get_result].map(|(name, kind)| there.server(name, kind, None));
    let Graph::Ros2(domain) = &*here["a"] else { panic!("DDS") };
    let mut graph = domain.graph();
    let seen = within("the server", graph.wait_for(|graph| graph.actions.contains_key(&name))).await.unwrap().clone();
    let peer = Peer::Ros2(seen.actions[&name].servers[0].clone());

    let types = Types::load([]).unwrap();
    let mut caller = pin!(ActionCaller::new(&here["a"], &types, &name, &peer));
    let early = tokio::time::timeout(Duration::from_secs(1), &mut caller).await;
    assert!(early.is_err(), "nothing publishes feedback yet");
    let writer = |(topic, kind): &(_, _), qos: Qos| there.writer(topic, kind, &qos.into()).unwrap();
    let _status = writer(&parts.status, Action::status_qos());
    let mut feedback = writer(&parts.feedback, Action::feedback_qos());
    let (caller, _) = within("the server is matched", caller).await.unwrap();
    within("feedback arrives", async {
        feedback.write(sample([0, 1, 0, 0], 64), 0).await.unwrap();
        assert!(matches!(caller.next_event().await.unwrap(), call::Event::Feedback(_)));
    })
    .await;
    drop(servers);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_of_any_type_cross_exactly_in_either_byte_order() {
    let (here, there) = (join(), join());
    let (topic, kind) = (topic("exact"), kind());
    let mut writer = here.writer(&topic, &kind, &LATCHED).unwrap();
    let reader = there.reader(&topic, &kind, &LATCHED).unwrap();

    for header in [[0, 1, 0, 0], [0, 0, 0, 0]] {
        for size in [8, 1_000_000] {
            let sent = sample(header, size);
            writer.write(sent.clone(), 1_700_000_000_000_000_000).await.unwrap();
            let received = within("a message crosses", reader.recv()).await.unwrap();
            assert_eq!(received.written_ns.map(|ns| ns / 1000), Some(1_700_000_000_000_000));
            assert!(received.sample == sent, "{header:?} {size}");
        }
    }
    here.leave().await;
    there.leave().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_the_participant_wrote_itself_is_not_read_back() {
    let (here, there) = (join(), join());
    let topic = topic("loop");
    let own_reader = here.reader(&topic, &kind(), &LATCHED).unwrap();
    let mut own_writer = here.writer(&topic, &kind(), &LATCHED).unwrap();
    let other_reader = there.reader(&topic, &kind(), &LATCHED).unwrap();
    let mut other_writer = there.writer(&topic, &kind(), &LATCHED).unwrap();

    own_writer.write(sample([0, 1, 0, 0], 16), 0).await.unwrap();
    let crossed = within("another participant reads it", other_reader.recv()).await.unwrap();
    assert_eq!(crossed.sample, sample([0, 1, 0, 0], 16));
    // Whatever comes first to our own reader is the other's: its message is longer, ours was
    // written before it.
    other_writer.write(sample([0, 1, 0, 0], 32), 0).await.unwrap();
    let read = within("the other's message is read", own_reader.recv()).await.unwrap();
    assert_eq!(read.sample, sample([0, 1, 0, 0], 32));
    here.leave().await;
    there.leave().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_best_effort_reader_is_served_by_a_reliable_writer() {
    let (here, there) = (join(), join());
    let topic = topic("best_effort");
    let mut writer = here.writer(&topic, &kind(), &RELIABLE).unwrap();
    let best_effort = Offer { reliable: false, ..RELIABLE };
    let reader = there.reader(&topic, &kind(), &best_effort).unwrap();
    let received = within("a message crosses", until_received(&mut writer, &reader)).await;
    assert_eq!(received, sample([0, 1, 0, 0], 64));
    here.leave().await;
    there.leave().await;
}

/// Its writer asks the thread that sends to take it up, and at once to send: each in a queue of its
/// own.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_written_as_soon_as_there_is_a_writer_is_sent() {
    let (here, there) = (join(), join());
    let topic = topic("at_once");
    let reader = there.reader(&topic, &kind(), &Offer { depth: 200, ..LATCHED }).unwrap();
    let mut writers = Vec::new();
    for i in 0..200 {
        let mut writer = here.writer(&topic, &kind(), &LATCHED).unwrap();
        writer.write(sample([0, 1, 0, 0], 4 * i), 0).await.unwrap();
        writers.push(writer);
    }
    let mut missing = (0..200).map(|i| sample([0, 1, 0, 0], 4 * i).bytes).collect::<HashSet<_>>();
    within("all are heard", async {
        while !missing.is_empty() {
            missing.remove(&reader.recv().await.unwrap().sample.bytes);
        }
    })
    .await;
    here.leave().await;
    there.leave().await;
}

/// The sink leaves one message in seven to the task, which takes its time. The writer pauses now
/// and then, and goes on until the sink has taken a message: it is asked only while the task waits.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_sink_overtakes_no_message_that_the_task_has() {
    const MESSAGES: u32 = 400;
    let (here, there) = (join(), join());
    let (topic, deep) = (topic("sink"), Offer { depth: 1000, ..RELIABLE });
    let mut writer = here.writer(&topic, &kind(), &deep).unwrap();
    let reader = there.reader(&topic, &kind(), &deep).unwrap();
    within("a message crosses", until_received(&mut writer, &reader)).await;
    let seen = Arc::<Mutex<Vec<u32>>>::default();
    let (by_sink, taken) = (seen.clone(), Arc::new(AtomicU32::new(0)));
    let taken_by_sink = taken.clone();
    reader.set_sink(Some(Box::new(move |arrived| match numbered(&arrived.sample) {
        Some(number) if number.is_multiple_of(7) => false,
        number => {
            taken_by_sink.fetch_add(number.is_some().into(), Ordering::Relaxed);
            by_sink.lock().unwrap().extend(number);
            true
        }
    })));
    let by_writer = taken.clone();
    let mut writing = tokio::spawn(async move {
        let mut number = 0;
        while number < MESSAGES || by_writer.load(Ordering::Relaxed) == 0 {
            number += 1;
            let bytes = [&[0, 1, 0, 0][..], &number.to_le_bytes()].concat();
            writer.write(RawSample::parse(bytes.into()).unwrap(), 0).await.unwrap();
            let pause = if number.is_multiple_of(25) || number >= MESSAGES { 50_000 } else { 300 };
            tokio::time::sleep(Duration::from_micros(pause)).await;
        }
        (writer, number)
    });
    let (mut written, mut by_task) = (None, 0);
    within("all are read", async {
        while written.as_ref().is_none_or(|(_, last)| seen.lock().unwrap().last() != Some(last)) {
            tokio::select! {
                read = reader.recv() => if let Some(number) = numbered(&read.unwrap().sample) {
                    tokio::time::sleep(Duration::from_millis(1)).await;
                    seen.lock().unwrap().push(number);
                    by_task += 1;
                },
                all = &mut writing, if written.is_none() => written = Some(all.unwrap()),
                () = tokio::time::sleep(Duration::from_millis(20)) => {}
            }
        }
    })
    .await;
    let (writer, last) = written.unwrap();
    assert_eq!(*seen.lock().unwrap(), (1..=last).collect::<Vec<_>>());
    assert_eq!(by_task + taken.load(Ordering::Relaxed), last);
    assert!(by_task >= last / 7, "{by_task}");
    drop(writer);
    here.leave().await;
    there.leave().await;
}

/// The number in a message of eight bytes.
fn numbered(sample: &RawSample) -> Option<u32> {
    Some(u32::from_le_bytes(sample.bytes.get(4..)?.try_into().ok()?))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_stays_on_the_host_finds_others_there() {
    let [here, there] = [(); 2].map(|()| Domain::join_within(Range::Localhost, domain_id(), "gdp_proxy_test").unwrap());
    let topic = topic("localhost");
    let mut writer = here.writer(&topic, &kind(), &RELIABLE).unwrap();
    let reader = there.reader(&topic, &kind(), &RELIABLE).unwrap();
    within("a message crosses", until_received(&mut writer, &reader)).await;
    here.leave().await;
    there.leave().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn ros_tools_see_the_proxy_as_a_node() {
    let context =
        ros2_client::Context::with_options(ros2_client::ContextOptions::new().domain_id(domain_id())).unwrap();
    let name = ros2_client::NodeName::new("/", "graph_observer").unwrap();
    let mut graph_observer = context.new_node(name, ros2_client::NodeOptions::new().enable_rosout(false)).unwrap();
    let spinner = tokio::spawn(graph_observer.spinner().unwrap().spin());
    let events = graph_observer.status_receiver().unwrap();
    let proxy = Domain::join(domain_id(), "gdp_proxy_seen").unwrap();
    within("the node is announced", async {
        loop {
            let ros2_client::NodeEvent::ParticipantEntities(info) = events.recv().await.unwrap() else { continue };
            if info.nodes().iter().any(|node| node.name() == "gdp_proxy_seen") {
                return;
            }
        }
    })
    .await;
    proxy.leave().await;
    spinner.abort();
}

fn join() -> Domain {
    Domain::join(domain_id(), "gdp_proxy_test").unwrap()
}

/// Volatile: what is written before the two have found each other is lost, so it is written again.
async fn until_received(writer: &mut RawWriter, reader: &RawReader) -> RawSample {
    loop {
        writer.write(sample([0, 1, 0, 0], 64), 0).await.unwrap();
        if let Ok(received) = tokio::time::timeout(Duration::from_millis(20), reader.recv()).await {
            return received.unwrap().sample;
        }
    }
}

async fn within<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(Duration::from_secs(60), future).await.unwrap_or_else(|_| panic!("not in time: {what}"))
}

/// An encapsulation header and a body of `size` bytes.
fn sample(header: [u8; 4], size: usize) -> RawSample {
    let body = (0..size).map(|i| (i % 251) as u8);
    RawSample::parse(Bytes::from_iter(header.into_iter().chain(body))).unwrap()
}

fn kind() -> TypeName {
    TypeName::parse("some_msgs/msg/Unheard").unwrap()
}

/// The domain of all these tests, which have topics of their own.
fn domain_id() -> u16 {
    static ID: LazyLock<u16> = LazyLock::new(lease);
    *ID
}

fn topic(test: &str) -> TopicName {
    TopicName::parse(&format!("/test_{}/{test}", std::process::id())).unwrap()
}
