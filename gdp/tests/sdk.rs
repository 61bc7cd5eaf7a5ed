//! Sessions and the examples, as programs, at a whole daemon on loopback UDP without root.

use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use futures::StreamExt as _;
use gdp::{Config, Encoding, Error, Identity, NameCard, RightError, Session, SigningKey};
use gdp_daemon::serve::{Running, start};
use gdp_tests::programs::own;

const TIMEOUT: Duration = Duration::from_secs(60);

#[tokio::test(flavor = "multi_thread")]
async fn examples_publish_and_subscribe() {
    let site = Site::new().await;
    let (robot, laptop) = (site.keyring("robot"), site.keyring("laptop"));
    let names = [&robot, &laptop].map(|keyring| keyring.1.name().to_string());
    let made = example("owner").arg(&robot.0).args(&names).status().unwrap();
    assert!(made.success());
    for file in ["chatter.card", "chatter.grant"] {
        std::fs::copy(robot.0.join(file), laptop.0.join(file)).unwrap();
    }
    let mut subscriber = site.run("subscribe", &laptop.0);
    let publisher = site.run("publish", &robot.0);
    let printed = subscriber.lines();
    let expected = [1, 2, 3].map(|count| format!("hello {count} from {:#}", robot.1.name()));
    assert_eq!(printed, expected);
    publisher.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn examples_serve_and_call() {
    let site = Site::new().await;
    let (robot, laptop) = (site.keyring("robot"), site.keyring("laptop"));
    site.name("service", "/light", &robot, &[&laptop]);
    let _server = site.run("service", &robot.0);
    let mut client = site.run("client", &laptop.0);
    assert_eq!(client.lines(), ["the light is on"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn clones_of_a_publisher_send_from_many_tasks_and_close_waits_for_the_reader() {
    let site = Site::new().await;
    let (robot, laptop) = (site.keyring("robot"), site.keyring("laptop"));
    let card = site.name("topic", "/chatter", &robot, &[&laptop]);
    let (talking, listening) = (site.session(&robot).await, site.session(&laptop).await);
    // By the first digits of the name, and as a stream.
    let samples = listening.subscriber(&card.name().to_string()[..12]).queue(usize::MAX).reliable().await.unwrap();
    let publisher = talking.publisher("chatter").reliable().encoding(Encoding::Json).await.unwrap();
    publisher.wait_for_readers(1).await.unwrap();
    let senders = (0..8).map(|task| {
        let publisher = publisher.clone();
        tokio::spawn(async move {
            for message in 0..50 {
                publisher.put(format!("[{task},{message}]")).await.unwrap();
            }
        })
    });
    for sender in senders.collect::<Vec<_>>() {
        sender.await.unwrap();
    }
    let reading = tokio::spawn(samples.take(400).collect::<Vec<_>>());
    talking.close().await.unwrap();
    let samples = tokio::time::timeout(TIMEOUT, reading).await.unwrap().unwrap();
    let samples: Vec<_> = samples.into_iter().map(Result::unwrap).collect();
    assert!(samples.iter().all(|sample| sample.encoding() == Encoding::Json && sample.source() == robot.1.name()));
    assert!(samples.windows(2).all(|pair| pair[1].sequence() == pair[0].sequence() + 1));
    let of_task =
        |task: u32| samples.iter().filter(move |sample| sample.text().unwrap().starts_with(&format!("[{task},")));
    assert!((0..8).all(|task| of_task(task).count() == 50));
    let age = samples[0].time().elapsed().unwrap_or_default();
    assert!(age < TIMEOUT, "{age:?}");
    assert!(publisher.put("late").await.is_err(), "the session is closed");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_ends_with_the_reason_when_the_right_expires() {
    let site = Site::new().await;
    let (robot, laptop) = (site.keyring("robot"), site.keyring("laptop"));
    let card = site.name("topic", "/chatter", &robot, &[]);
    let short = site.owner.allow_read(&card, laptop.1.name()).valid_for(Duration::from_secs(3)).sign().unwrap();
    std::fs::write(laptop.0.join("chatter.grant"), short.to_pem()).unwrap();
    card.save_new(&laptop.0.join("chatter.card")).unwrap();
    let session = site.session(&laptop).await;
    let mut subscriber = session.subscriber("/chatter").await.unwrap();
    let last = tokio::time::timeout(TIMEOUT, subscriber.next()).await.unwrap();
    let Some(Err(error @ Error::Ended(_))) = last else { panic!("{last:?}") };
    assert!(error.to_string().contains("expired"), "{error}");
    assert!(subscriber.next().await.is_none());
    // And after a close, it ends without an error.
    site.name("service", "/light", &robot, &[]);
    let other = site.session(&robot).await;
    let mut server = other.server("/light").await.unwrap();
    other.close().await.unwrap();
    assert!(server.recv().await.unwrap().is_none());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_receive_that_is_cancelled_loses_nothing() {
    let site = Site::new().await;
    let (robot, laptop) = (site.keyring("robot"), site.keyring("laptop"));
    site.name("topic", "/chatter", &robot, &[&laptop]);
    site.name("service", "/light", &robot, &[&laptop]);
    let (talking, listening) = (site.session(&robot).await, site.session(&laptop).await);
    let mut subscriber = listening.subscriber("/chatter").reliable().await.unwrap();
    let publisher = talking.publisher("/chatter").reliable().await.unwrap();
    publisher.wait_for_readers(1).await.unwrap();
    let publishing = tokio::spawn(async move {
        for message in 0..500 {
            publisher.put(message.to_string()).await.unwrap();
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        publisher
    });
    let (mut cancelled, short) = (0, Duration::from_micros(200));
    for expected in 0..500 {
        let sample = loop {
            match tokio::time::timeout(short, subscriber.recv()).await {
                Ok(sample) => break sample.unwrap().unwrap(),
                Err(_) => cancelled += 1,
            }
        };
        assert_eq!(sample.text().unwrap(), expected.to_string());
    }
    assert!(cancelled > 10, "{cancelled}");
    drop(publishing.await.unwrap());

    let mut server = talking.server("/light").await.unwrap();
    let client = listening.client("/light").await.unwrap();
    let calling = tokio::spawn(async move {
        for request in 0..50 {
            let request = request.to_string();
            assert_eq!(client.call(&request).await.unwrap().text().unwrap(), request);
        }
    });
    let mut answered = 0;
    while answered < 50 {
        if let Ok(call) = tokio::time::timeout(short, server.recv()).await {
            let call = call.unwrap().unwrap();
            let request = call.payload().clone();
            call.reply(request).await.unwrap();
            answered += 1;
        }
    }
    tokio::time::timeout(TIMEOUT, calling).await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn rights_that_are_added_or_renewed_in_the_folder_are_taken() {
    let site = Site::new().await;
    let (robot, laptop) = (site.keyring("robot"), site.keyring("laptop"));
    let (talking, listening) = (site.session(&robot).await, site.session(&laptop).await);
    assert!(matches!(listening.subscriber("/chatter").await, Err(Error::Find(_))));
    let card = site.name("topic", "/chatter", &robot, &[&laptop]);
    let grant = |time| {
        let grant = site.owner.allow_read(&card, laptop.1.name()).valid_for(time).sign().unwrap();
        std::fs::write(laptop.0.join("chatter.grant"), grant.to_pem()).unwrap();
    };
    let short = Duration::from_secs(3);
    grant(short);
    let mut subscriber = listening.subscriber("/chatter").await.unwrap();
    grant(Duration::from_secs(3600));
    subscriber.renew().await.unwrap();
    // The first grant ends meanwhile.
    tokio::time::sleep(short + Duration::from_secs(1)).await;
    let publisher = talking.publisher("/chatter").reliable().await.unwrap();
    publisher.wait_for_readers(1).await.unwrap();
    publisher.renew().await.unwrap();
    publisher.put("still there").await.unwrap();
    let sample = tokio::time::timeout(TIMEOUT, subscriber.recv()).await.unwrap().unwrap().unwrap();
    assert_eq!(sample.text().unwrap(), "still there");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_missing_is_named_with_its_remedy() {
    let site = Site::new().await;
    let (robot, laptop) = (site.keyring("robot"), site.keyring("laptop"));
    site.name("topic", "/chatter", &robot, &[]);
    let card = site.name("service", "/light", &robot, &[&laptop]);
    let session = site.session(&laptop).await;
    let unknown = session.subscriber("/chatter").await.unwrap_err().to_string();
    assert!(unknown.contains("no name card of a topic /chatter"), "{unknown}");
    // The laptop may call the service, and may not serve it.
    let error = session.server(card.name().to_string()).await.unwrap_err();
    assert!(matches!(error, Error::Right(RightError::Missing(_))) && !error.may_pass(), "{error:?}");
    assert!(error.to_string().contains("gdp-ctl grant add"), "{error}");
    let client = session.client("/light").timeout(Duration::from_millis(200)).await.unwrap();
    let silent = client.call("on").await.unwrap_err();
    assert!(matches!(silent, Error::NoServer { .. }) && silent.may_pass(), "{silent}");

    let nowhere = gdp::open(Config::new(site.folder.path().join("nowhere"))).await.unwrap_err().to_string();
    assert!(nowhere.contains("GDP_KEYRING"), "{nowhere}");
    std::fs::remove_file(laptop.0.join("id.pem")).unwrap();
    let no_key = gdp::open(Config::new(&laptop.0)).await.unwrap_err().to_string();
    assert!(no_key.contains("id.pem") && no_key.contains("gdp-ctl key generate"), "{no_key}");
}

#[test]
fn handles_can_be_used_from_any_thread_and_printed() {
    fn anywhere<T: Send + Sync + std::fmt::Debug>() {}
    fn cloned<T: Clone>() {}
    anywhere::<Session>();
    anywhere::<gdp::Publisher>();
    anywhere::<gdp::Client>();
    anywhere::<gdp::Sample>();
    anywhere::<Config>();
    anywhere::<Error>();
    cloned::<gdp::Publisher>();
    cloned::<gdp::Client>();
    cloned::<Session>();
}

/// A daemon, and folders of entities.
struct Site {
    folder: tempfile::TempDir,
    daemon: Running,
    owner: SigningKey,
}

/// The folder of an entity's keyring, and the entity.
type Entity = (PathBuf, Identity);

impl Site {
    async fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (key, any_port) = (folder.path().join("switch.pem"), "127.0.0.1:0".parse().unwrap());
        let config = gdp_daemon::config::Config {
            rib: true,
            fib_capacity: 1024,
            ..gdp_daemon::config::Config::userspace(key, any_port)
        };
        let daemon = start(config).await.unwrap();
        Self { folder, daemon, owner: SigningKey::generate().unwrap() }
    }

    fn switch(&self) -> String {
        format!("udp://{}", self.daemon.udp_addr().unwrap())
    }

    fn keyring(&self, label: &str) -> Entity {
        let folder = self.folder.path().join(label);
        std::fs::create_dir(&folder).unwrap();
        let identity = Identity::load_or_generate(&folder.join("id.pem"), "proxy").unwrap();
        (folder, identity)
    }

    /// Creates a name with the rights of its writer and readers, in their keyrings.
    fn name(&self, kind: &str, topic: &str, writer: &Entity, readers: &[&Entity]) -> NameCard {
        let card = NameCard::create(self.owner.verify_key(), kind, topic, "std_msgs/msg/String", None).unwrap();
        let file = |folder: &Path, ending: &str| folder.join(format!("{}.{ending}", topic.trim_start_matches('/')));
        let ad = self.owner.allow_publish(&card, writer.1.name()).for_days(1).sign().unwrap();
        card.save_new(&file(&writer.0, "card")).unwrap();
        std::fs::write(file(&writer.0, "ad"), ad.to_pem()).unwrap();
        for reader in readers {
            let grant = self.owner.allow_read(&card, reader.1.name()).for_days(1).sign().unwrap();
            card.save_new(&file(&reader.0, "card")).unwrap();
            std::fs::write(file(&reader.0, "grant"), grant.to_pem()).unwrap();
        }
        card
    }

    async fn session(&self, entity: &Entity) -> Session {
        gdp::open(Config::new(&entity.0).switch(self.switch().parse().unwrap())).await.unwrap()
    }

    /// Starts an example with this keyring.
    fn run(&self, name: &str, keyring: &Path) -> Program {
        let mut command = example(name);
        command.env("GDP_KEYRING", keyring).env("GDP_SWITCH", self.switch());
        Program(command.stdout(Stdio::piped()).stdin(Stdio::null()).spawn().unwrap())
    }
}

/// A running program, until it is dropped.
struct Program(Child);

impl Program {
    /// Returns what it prints until it ends, which must be a success.
    fn lines(&mut self) -> Vec<String> {
        let output = BufReader::new(self.0.stdout.take().unwrap());
        let lines = output.lines().map(Result::unwrap).collect();
        assert!(self.0.wait().unwrap().success(), "{lines:?}");
        lines
    }

    fn end(mut self) {
        assert!(self.0.wait().unwrap().success());
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // It may have ended by itself.
        _ = self.0.kill();
        _ = self.0.wait();
    }
}

/// An example of this crate. This test is in `target/PROFILE/deps`.
fn example(name: &str) -> Command {
    let program = std::env::current_exe().unwrap().ancestors().nth(2).unwrap().join("examples").join(name);
    assert!(program.is_file(), "{} does not exist: `cargo test` builds it unless --test is given", program.display());
    own(program)
}
