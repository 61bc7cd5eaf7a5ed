//! The endpoint of `conformance/`, which was written from the document alone, at a real switch:
//!
//! ```text
//!  endpoint in Python ─┐
//!                      ├─ host e0 ──── l0 switch
//!  SDK ────────────────┘
//! ```

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use gdp_tests::Tools;
use gdp_tests::netns::execute;
use gdp_tests::process::Process;
use gdp_tests::programs::own;
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::json;

use crate::inside::{Inside, ROOT};
use crate::lone_switch::LoneSwitch;

const COUNT: u64 = 1000;
const SWITCH: &str = "10.9.0.1:31415";

#[test]
fn the_vectors_hold_in_another_implementation() -> Result<()> {
    let mut pytest = own(Tools::beside_this_test()?.python_of_conformance()?);
    pytest.args(["-B", "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests"]).current_dir(conformance());
    let told = execute(&mut pytest)?;
    ensure!(told.contains(" passed") && !told.contains("skipped"), "{told}");
    Ok(())
}

#[test]
fn messages_pass_both_ways_between_two_implementations_over_xdp() -> Result<()> {
    exchange("xdp", 0)
}

/// Each side repairs for the other what the endpoint in Python loses on purpose.
#[test]
fn two_implementations_repair_each_others_losses() -> Result<()> {
    exchange("userspace", 10)
}

#[test]
fn a_switch_refuses_another_implementation_with_the_codes_of_the_document() -> Result<()> {
    let site = Site::build("userspace")?;
    let mut endpoint = site.endpoint("refusals", &[])?;
    let status = wait_for("the refusals", TIMEOUT, || endpoint.status()).with_context(|| endpoint.report())?;
    ensure!(status.success(), "{}", endpoint.report());
    let cases = endpoint.json_lines();
    let answer = |case: &str| cases.iter().find(|line| line["case"] == case).map(|line| line["answer"].clone());
    ensure!(answer("the right of another to publish") == Some(json!("WrongEntity")), "{cases:?}");
    ensure!(answer("a frame to a name of another") == Some(json!("not_authorised")), "{cases:?}");
    Ok(())
}

/// Has both endpoints send all their messages, and read those of the other. `lose`: which data
/// frame in so many the endpoint in Python loses, in each direction; 0 for none.
fn exchange(data_plane: &str, lose: u64) -> Result<()> {
    let site = Site::build(data_plane)?;
    let mut endpoint = site.endpoint("exchange", &[("--count", COUNT), ("--lose", lose)])?;
    let inside = Inside::new(&site.0.remote, ROOT)?;
    let keyring = site.path("rust");
    // The reasons of the endpoint in Python are those that tell most.
    let exchanged = inside.run(async move { tokio::time::timeout(2 * TIMEOUT, InRust::exchange(keyring)).await })?;
    let rust = exchanged.map_err(Into::into).flatten().with_context(|| endpoint.report())?;
    ensure!(rust.numbers.iter().copied().eq(1..=COUNT), "not in order: {:?}", rust.numbers);
    endpoint.wait_event("acknowledged", TIMEOUT)?;
    let received = endpoint.wait_event("received", TIMEOUT)?;
    ensure!(received["complete"] == true, "{received}");
    let records = endpoint.wait_event("records", TIMEOUT)?;
    ensure!(records["entities"].as_array().is_some_and(|entities| entities.len() == 2), "{records}");
    let done = endpoint.wait_event("done", TIMEOUT)?;
    ensure!(lose > 0 || done["drops"] == json!([{}, {}, {}]), "{done}");
    if data_plane == "xdp" {
        let status = site.0.status()?;
        let delivered = |plane: &str| status["counters_by_plane"]["delivered"][plane].as_u64();
        // The SDK puts several messages into a frame.
        ensure!(delivered("kernel") > Some(COUNT), "{}", status["counters_by_plane"]);
        ensure!(delivered("userspace") == Some(0), "{}", status["counters_by_plane"]);
    }
    inside.run(rust.close())??;
    std::fs::write(site.path("python").join("stop"), "")?;
    let status = wait_for("the end", TIMEOUT, || endpoint.status()).with_context(|| endpoint.report())?;
    ensure!(status.success(), "{}", endpoint.report());
    Ok(())
}

/// The SDK's end of the exchange.
struct InRust {
    /// Of the messages that came, in their order.
    numbers: Vec<u64>,
    session: gdp::Session,
    publisher: gdp::Publisher,
    subscriber: gdp::Subscriber,
}

impl InRust {
    /// Publishes `/inward` and reads `/outward`, all messages of each.
    async fn exchange(keyring: PathBuf) -> Result<Self> {
        let switch = format!("udp://{SWITCH}").parse()?;
        let session = gdp::open(gdp::Config::new(keyring).switch(switch)).await?;
        let mut subscriber = session.subscriber("/outward").await?;
        let publisher = session.publisher("/inward").reliable().await?;
        let sending = async {
            publisher.wait_for_readers(1).await?;
            for number in 1..=COUNT {
                publisher.put(body(number)).await?;
            }
            Ok::<_, anyhow::Error>(publisher.flush(Duration::from_secs(30)).await?)
        };
        let reading = async {
            let mut numbers = Vec::new();
            while numbers.len() < COUNT as usize {
                let sample = subscriber.recv().await?.context("a message")?;
                let number = u64::from_be_bytes(sample.payload()[..8].try_into()?);
                ensure!(sample.payload()[..] == body(number), "message {number} is another");
                numbers.push(number);
            }
            Ok(numbers)
        };
        let ((), numbers) = tokio::try_join!(sending, reading)?;
        Ok(Self { numbers, session, publisher, subscriber })
    }

    /// Withdraws both names, and ends the session.
    async fn close(self) -> Result<()> {
        drop((self.publisher, self.subscriber));
        Ok(self.session.close().await?)
    }
}

/// Returns the body of a numbered message, as `conformance/endpoint/exchange.py` makes it.
fn body(number: u64) -> Vec<u8> {
    let length = if number.is_multiple_of(100) { 5000 } else { number % 200 };
    let mut body = number.to_be_bytes().to_vec();
    body.resize(8 + length as usize, number as u8);
    body
}

fn conformance() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../conformance")
}

/// A switch, and a host with two endpoints that may publish and read each other's topic.
struct Site(LoneSwitch);

impl Site {
    fn build(data_plane: &str) -> Result<Self> {
        let site = Self(LoneSwitch::build(data_plane)?);
        site.0.remote.ip(&["addr", "add", "10.9.0.2/24", "dev", "e0"])?;
        site.issue()?;
        Ok(site)
    }

    /// Makes the keys of both endpoints, and the cards and certificates of both topics.
    fn issue(&self) -> Result<()> {
        let file = |path: &str| self.path(path).display().to_string();
        let owner = file("owner.pem");
        self.ctl(&["key", "generate", &owner, "--kind", "owner"])?;
        for folder in ["python", "rust"] {
            std::fs::create_dir(self.path(folder))?;
            self.ctl(&["key", "generate", &file(&format!("{folder}/id.pem")), "--kind", "proxy"])?;
        }
        for (topic, from, to) in [("outward", "python", "rust"), ("inward", "rust", "python")] {
            let card = file(&format!("{topic}.card"));
            let (name, r#type) = (format!("/{topic}"), "std_msgs/msg/String");
            self.ctl(&["name", "create", "--owner", &owner, "--topic", &name, "--type", r#type, "-o", &card])?;
            for (folder, right, suffix) in [(from, "--publish", "ad"), (to, "--read", "grant")] {
                std::fs::copy(&card, self.path(folder).join(format!("{topic}.card")))?;
                let (entity, to) = (file(&format!("{folder}/id.pem")), file(&format!("{folder}/{topic}.{suffix}")));
                self.ctl(&["grant", "add", &card, "--key", &owner, right, "--entity", &entity, "-o", &to])?;
            }
        }
        Ok(())
    }

    /// Starts the endpoint in Python.
    fn endpoint(&self, verb: &str, options: &[(&str, u64)]) -> Result<Process> {
        let mut command = self.0.remote.command(self.0.tools.python_of_conformance()?)?;
        command.args(["-B", "-m", "endpoint", verb, "--switch", SWITCH, "--folder"]).arg(self.path("python"));
        for (option, value) in options {
            command.arg(option).arg(value.to_string());
        }
        command.current_dir(conformance());
        Process::spawn("endpoint", command, &self.path(""))
    }

    fn path(&self, file: &str) -> PathBuf {
        self.0.path(file)
    }

    fn ctl(&self, arguments: &[&str]) -> Result<String> {
        execute(own(self.0.tools.gdp_ctl()?).args(arguments))
    }
}
