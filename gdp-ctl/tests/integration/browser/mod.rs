//! A real Chromium without a window, by its DevTools protocol.

use std::time::{Duration, Instant};

use base64ct::{Base64, Encoding};
use futures::{SinkExt, StreamExt};
use gdp_tests::process::Process;
use gdp_tests::programs::{Executable as _, Program};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;

use crate::switch::TIMEOUT;

/// A browser with one open page.
pub struct Browser {
    socket: WebSocketStream<TcpStream>,
    session: Option<String>,
    next: u64,
    /// What the page reported: errors, exceptions, and violations of its policy.
    pub reports: Vec<String>,
    _process: Process,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Starts the browser and opens an empty page.
    pub async fn start() -> Self {
        let profile = tempfile::tempdir().unwrap();
        let mut command = Program::Chromium.command();
        // As root, Chromium has no sandbox. A container may have a small /dev/shm.
        command.args(["--headless", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", "--no-first-run"]);
        command.args(["--disable-background-networking", "--disable-component-update", "--hide-scrollbars"]);
        command.arg("--remote-debugging-port=0").arg(format!("--user-data-dir={}", profile.path().display()));
        command.arg("about:blank");
        let mut process = Process::spawn("chromium", command, profile.path()).unwrap();
        let begins = "DevTools listening on ws://";
        let address = |p: &Process| {
            let errors = p.stderr();
            let complete = &errors[..errors.rfind('\n')?];
            complete.lines().find_map(|line| Some(line.strip_prefix(begins)?.to_owned()))
        };
        let address = process.wait_until("its DevTools address", TIMEOUT, address).unwrap();
        let (host, _) = address.split_once('/').unwrap();
        let stream = TcpStream::connect(host).await.unwrap();
        // Screenshots are large messages.
        let limits = WebSocketConfig::default().max_message_size(Some(64 << 20)).max_frame_size(Some(64 << 20));
        let url = format!("ws://{address}");
        let (socket, _) = tokio_tungstenite::client_async_with_config(url, stream, Some(limits)).await.unwrap();
        let (reports, session) = (Vec::new(), None);
        let mut browser = Self { socket, session, next: 0, reports, _process: process, _profile: profile };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"})).await;
        let attach = json!({"targetId": target["targetId"], "flatten": true});
        browser.session = browser.call("Target.attachToTarget", attach).await["sessionId"].as_str().map(Into::into);
        for domain in ["Page", "Runtime", "Log"] {
            browser.call(&format!("{domain}.enable"), json!({})).await;
        }
        browser
    }

    pub async fn open(&mut self, url: &str) {
        let opened = self.call("Page.navigate", json!({"url": url})).await;
        assert_eq!(opened["errorText"], Value::Null, "{opened}");
    }

    /// Returns the value of an expression in the page.
    pub async fn evaluate(&mut self, expression: &str) -> Value {
        self.try_evaluate(expression).await.unwrap_or_else(|exception| panic!("{expression}: {exception}"))
    }

    async fn try_evaluate(&mut self, expression: &str) -> Result<Value, Value> {
        let parameters = json!({"expression": expression, "returnByValue": true, "awaitPromise": true});
        let mut answer = self.call("Runtime.evaluate", parameters).await;
        match answer["exceptionDetails"].take() {
            Value::Null => Ok(answer["result"]["value"].take()),
            exception => Err(exception),
        }
    }

    /// Waits until an expression in the page is true. Before the page is loaded, what the
    /// expression looks for may not exist.
    pub async fn wait(&mut self, expression: &str) {
        let deadline = Instant::now() + TIMEOUT;
        while self.try_evaluate(expression).await != Ok(Value::Bool(true)) {
            if Instant::now() > deadline {
                let text = self.evaluate("document.body.innerText").await;
                panic!("waited in vain for {expression}\n{}\n{:?}", text.as_str().unwrap_or_default(), self.reports);
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    /// Sets the size of the page and the user's colours. Returns a picture of all of it, as PNG.
    pub async fn picture(&mut self, width: u32, height: u32, scheme: &str) -> Vec<u8> {
        let size = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false});
        self.call("Emulation.setDeviceMetricsOverride", size).await;
        let colours = json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]});
        self.call("Emulation.setEmulatedMedia", colours).await;
        let whole = json!({"format": "png", "captureBeyondViewport": true});
        let picture = self.call("Page.captureScreenshot", whole).await;
        Base64::decode_vec(picture["data"].as_str().unwrap()).unwrap()
    }

    async fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.next += 1;
        let mut request = json!({"id": self.next, "method": method, "params": parameters});
        if let Some(session) = &self.session {
            request["sessionId"] = json!(session);
        }
        self.socket.send(Message::text(request.to_string())).await.unwrap();
        loop {
            let message = tokio::time::timeout(TIMEOUT, self.socket.next()).await.expect("an answer in time");
            let Message::Text(text) = message.expect("a live browser").unwrap() else { continue };
            let mut message: Value = serde_json::from_str(&text).unwrap();
            if message["id"] == self.next {
                assert_eq!(message["error"], Value::Null, "{method}");
                return message["result"].take();
            }
            let is_report = match message["method"].as_str() {
                Some("Runtime.exceptionThrown" | "Log.entryAdded") => true,
                Some("Runtime.consoleAPICalled") => message["params"]["type"] == "error",
                _ => false,
            };
            if is_report {
                self.reports.push(message["params"].to_string());
            }
        }
    }
}
