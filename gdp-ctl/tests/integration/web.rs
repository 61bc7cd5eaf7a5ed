//! The page of `gdp-ctl web` in a real browser, in front of real daemons and publishers, and its
//! server for clients that are not admitted.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt as _;
use std::process::{Child, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use gdp::unstable::{Node, NodeConfig, PublishOptions, SubscribeOptions};
use gdp_core::card::NameCard;
use gdp_core::cert::{AdCert, Grantee, ReadGrant, issue};
use gdp_core::identity::{Identity, SigningKey};
use gdp_daemon::serve::{Running, start};
use gdp_e2e::seal::Encoding;
use gdp_tests::process::terminate;

use crate::browser::Browser;
use crate::switch::{Chain, wait};
use crate::user::User;

/// A name that is markup, and runs a script where it is taken for markup.
const HOSTILE: &str = "/<img src=x onerror=\"document.title='pwned'\">";

#[tokio::test(flavor = "multi_thread")]
async fn the_page_shows_switches_links_names_rates_paths_and_what_is_down() {
    let user = User::new();
    let scene = Scene::start(&user).await;
    let mut web = Web::start(&user, &["--keyring", "keys", "--dir", "none", "--listen", "127.0.0.1:0"]);
    let mut browser = Browser::start().await;
    browser.open(&web.url).await;

    browser.wait("document.querySelectorAll('#map circle').length === 3").await;
    for name in &scene.names {
        browser.wait(&format!("document.querySelector('#map').textContent.includes('{name:#}')")).await;
    }
    assert_eq!(browser.evaluate("location.search").await, "", "the token is no longer in the address");
    assert_eq!(browser.evaluate("document.cookie").await, "", "scripts cannot read it");
    browser.wait("document.querySelector('#verdict').textContent === 'Nothing is down'").await;
    let links = "[...document.querySelectorAll('#links tbody tr')].map((row) => row.cells[1].textContent).join()";
    assert_eq!(browser.evaluate(links).await, "switch,endpoint");

    let hostile = serde_json::json!(HOSTILE).to_string();
    browser.wait(&format!("document.querySelector('#names button')?.textContent === {hostile}")).await;
    assert_eq!(browser.evaluate("document.querySelectorAll('img').length").await, 0, "it is text");

    // Rates follow the publisher.
    let rate = "Number(document.querySelectorAll('#links tbody tr')[1].cells[3].textContent)";
    browser.wait(&format!("{rate} > 5")).await;
    scene.period_ms.store(2, Ordering::Relaxed);
    browser.wait(&format!("{rate} > 100")).await;

    browser.evaluate("document.querySelector('#names button').click()").await;
    browser.wait("document.querySelector('#found pre')?.textContent.startsWith('trace to ')").await;
    let roles = "[...document.querySelectorAll('#found tbody tr')].map((row) => row.cells[0].textContent + ' ' \
                 + row.cells[3].textContent).sort().join()";
    assert_eq!(browser.evaluate(roles).await, "publisher verified,subscriber verified");

    browser.wait("document.querySelectorAll('#map .onpath').length === 2").await;
    for (width, height, scheme) in [(1280, 860, "light"), (1280, 860, "dark"), (390, 844, "light"), (390, 844, "dark")]
    {
        let picture = browser.picture(width, height, scheme).await;
        let overflow = "document.documentElement.scrollWidth - document.documentElement.clientWidth";
        assert_eq!(browser.evaluate(overflow).await, 0, "the page is {width} wide");
        if let Some(folder) = std::env::var_os("GDP_SCREENSHOTS") {
            let file = format!("{width}-{scheme}.png");
            std::fs::write(std::path::Path::new(&folder).join(file), picture).unwrap();
        }
    }

    let mut switches = scene.switches;
    switches.remove(0).stop().await;
    browser.wait("document.body.classList.contains('down') && document.title.includes('down')").await;
    let lost = format!("document.querySelector('#problems').textContent.includes('{:#}')", scene.names[0]);
    browser.wait(&lost).await;
    browser.wait("document.querySelector('#events').textContent.includes('2 of 3 switches reached')").await;
    assert_eq!(browser.reports, [""; 0], "neither errors nor violations of the policy");
    assert_eq!(browser.evaluate("document.title.includes('pwned')").await, false);

    web.stop();
    browser.wait("document.querySelector('#verdict').textContent.includes('does not answer')").await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_says_that_no_daemon_answers_and_shows_it_when_it_comes() {
    let user = User::new();
    let web = Web::start(&user, &["--dir", "none", "--listen", "127.0.0.1:0"]);
    let mut browser = Browser::start().await;
    browser.open(&web.url).await;
    browser.wait("document.querySelector('#problems').textContent.includes('no daemon answers')").await;
    let mut config = crate::switch::config(user.folder.path(), "s1");
    config.socket = user.file("ctl.sock");
    let switch = start(config).await.unwrap();
    browser.wait("document.querySelector('#verdict').textContent === 'Nothing is down'").await;
    browser.wait("document.querySelector('#links').textContent.includes('has no links')").await;
    browser.wait("document.querySelector('#names').textContent.includes('Nobody publishes')").await;
    switch.stop().await;
    assert_eq!(browser.reports, [""; 0]);
}

#[test]
fn only_who_has_the_token_and_names_this_machine_is_answered() {
    let user = User::new();
    let mut web = Web::start(&user, &["--dir", "none", "--listen", "127.0.0.1:0"]);
    let (address, token) = (web.address.clone(), web.token().to_owned());
    let get = |path: &str, headers: &[&str]| {
        let host = format!("Host: {address}");
        let named = headers.iter().any(|header| header.starts_with("Host:"));
        let headers: Vec<&str> = headers.iter().copied().chain((!named).then_some(host.as_str())).collect();
        let mut stream = TcpStream::connect(&address).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\nConnection: close\r\n{}\r\n\r\n", headers.join("\r\n")).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    };
    let bare = format!("Cookie: gdp_web={token}");
    assert!(get("/", &[&bare]).starts_with("HTTP/1.1 401"), "the cookie is not the token");
    for path in ["/", "/page.js", "/api/snapshot", "/api/path?name=1", "/?token=0123456789abcdef", "/nothing"] {
        assert!(get(path, &[]).starts_with("HTTP/1.1 401"), "{path}");
    }
    let first = get(&format!("/?token={token}"), &[]);
    assert!(first.starts_with("HTTP/1.1 303") && first.contains("HttpOnly; SameSite=Strict"), "{first}");
    let (pair, _) = first.split_once("set-cookie: ").unwrap().1.split_once(';').unwrap();
    let cookie = format!("Cookie: {pair}");
    assert!(get("/", &[&cookie, "Host: evil.example"]).starts_with("HTTP/1.1 421"));
    assert!(get(&format!("/?token={token}"), &[&cookie]).starts_with("HTTP/1.1 303"), "it leaves the address");
    let page = get("/", &[&cookie]);
    assert!(page.starts_with("HTTP/1.1 200"), "{page}");
    for header in ["default-src 'none'", "cache-control: no-store", "x-content-type-options: nosniff"] {
        assert!(page.contains(header), "{header}: {page}");
    }
    assert!(!page.to_lowercase().contains("access-control"), "no other origin reads it");
    assert!(!page.contains("http://") && !page.contains("https://"), "nothing comes from elsewhere");
    assert!(get("/api/path?name=xyz", &[&cookie]).starts_with("HTTP/1.1 400"));
    assert!(get("/api/snapshot", &[&cookie]).contains("no daemon answers"));
    assert!(!web.stop().contains(&token), "the token is in no message but the address");

    let refused = user.refusal(1, &["web", "--listen", "0.0.0.0:0"]);
    assert!(refused.contains("--token-file"), "{refused}");
    let refused = user.refusal(1, &["web", "--listen", "127.0.0.1:0"]);
    assert!(refused.contains("no terminal") && refused.contains("--token-file"), "{refused}");
    std::fs::set_permissions(user.file("token"), std::fs::Permissions::from_mode(0o604)).unwrap();
    let refused = user.refusal(1, &["web", "--token-file", "token"]);
    assert!(refused.contains("chmod"), "{refused}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_hangs_delays_nobody_and_the_page_says_so() {
    let user = User::new();
    let socket = user.file("ctl.sock");
    // It accepts clients, and never answers.
    let hangs = std::os::unix::net::UnixListener::bind(&socket).unwrap();
    let web = Web::start(&user, &["--dir", "none", "--listen", "127.0.0.1:0"]);
    let mut browser = Browser::start().await;
    browser.open(&web.url).await;
    browser.wait("document.querySelector('#verdict').textContent.includes('daemon has not answered for')").await;
    // Clients that hang end with the listener, and a daemon takes its place.
    drop(hangs);
    std::fs::remove_file(&socket).unwrap();
    let mut config = crate::switch::config(user.folder.path(), "s1");
    config.socket = socket.clone();
    let switch = start(config).await.unwrap();
    browser.wait("document.querySelector('#verdict').textContent === 'Nothing is down'").await;
    // What it said last stays, marked with its age.
    std::fs::rename(&socket, user.file("moved")).unwrap();
    let _hangs = std::os::unix::net::UnixListener::bind(&socket).unwrap();
    browser.wait("document.querySelector('#verdict').textContent.includes('daemon has not answered for')").await;
    browser.wait("document.body.classList.contains('stale')").await;
    assert_eq!(browser.evaluate("document.querySelectorAll('#map circle').length").await, 1);
    switch.stop().await;
}

/// A running `gdp-ctl web`.
struct Web {
    child: Child,
    url: String,
    address: String,
}

impl Web {
    fn start(user: &User, arguments: &[&str]) -> Self {
        let token = "0123456789abcdef".repeat(2);
        std::fs::write(user.file("token"), &token).unwrap();
        std::fs::set_permissions(user.file("token"), std::fs::Permissions::from_mode(0o600)).unwrap();
        let mut command = user.command(&[&["web", "--token-file", "token"], arguments].concat());
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut url).unwrap();
        // Whoever has the file knows its token.
        let (page, "…") = url.trim().split_at(url.find('…').expect(&url)) else { panic!("{url}") };
        let url = format!("{page}{token}");
        let address = url.strip_prefix("http://").and_then(|rest| rest.split_once('/')).expect(&url).0.to_owned();
        Self { child, url, address }
    }

    fn token(&self) -> &str {
        self.url.split_once("token=").unwrap().1
    }

    /// Ends the program, and returns its messages.
    fn stop(&mut self) -> String {
        terminate(&self.child).unwrap();
        assert!(self.child.wait().unwrap().success());
        let mut messages = String::new();
        self.child.stderr.as_mut().unwrap().read_to_string(&mut messages).unwrap();
        messages
    }
}

impl Drop for Web {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Three switches in a row. A reader is at the first, a publisher at the last, which has the RIB
/// and the user's socket.
struct Scene {
    names: Vec<gdp_wire::Name>,
    switches: Vec<Running>,
    /// Time between two messages.
    period_ms: Arc<AtomicU64>,
}

impl Scene {
    async fn start(user: &User) -> Self {
        let chain = Chain::new(user.folder.path());
        let mut switches = Vec::new();
        for i in 0..3 {
            let mut config = chain.config(i);
            if i == 2 {
                config.socket = user.file("ctl.sock");
            }
            switches.push(start(config).await.unwrap());
        }
        let owner = SigningKey::generate().unwrap();
        let card = NameCard::create(owner.verify_key(), "topic", HOSTILE, "T", None).unwrap();
        std::fs::create_dir(user.file("keys")).unwrap();
        card.save_new(&user.file("keys/hostile.card")).unwrap();
        let until = gdp_util::unix_time::unix_seconds() + 3600;
        let [writer, reader] = [2, 0].map(|i| (Identity::generate("proxy").unwrap(), chain.addrs[i]));
        let connect = async |(identity, at): &(Identity, std::net::SocketAddr)| {
            Node::connect(NodeConfig::new(identity.clone(), format!("udp://{at}").parse().unwrap())).await.unwrap()
        };
        let (scope, serial, not_before) = (vec![], 1, 0);
        let ad = AdCert { name: card.name(), entity: writer.0.name(), scope, serial, not_before, not_after: until };
        let to = Grantee::Entity(reader.0.name());
        let grant = ReadGrant { name: card.name(), to, serial, not_before, not_after: until };
        let reading = connect(&reader).await;
        let grant = issue(&owner, &grant).unwrap().into();
        let mut subscription = reading.subscribe(card.proof(), grant, SubscribeOptions::reliable()).await.unwrap();
        let writing = connect(&writer).await;
        let ad = issue(&owner, &ad).unwrap().into();
        let mut publisher = writing.publish(card.proof(), ad, PublishOptions::best_effort()).await.unwrap();
        let period_ms = Arc::new(AtomicU64::new(50));
        let period = period_ms.clone();
        // They end with the test's runtime.
        tokio::spawn(async move {
            let _reading = reading;
            while subscription.recv().await.is_some() {}
        });
        tokio::spawn(async move {
            let _writing = writing;
            loop {
                let _ = publisher.send(Encoding::Bytes, b"a message").await;
                tokio::time::sleep(Duration::from_millis(period.load(Ordering::Relaxed))).await;
            }
        });
        let first = &switches[0];
        wait("frames to arrive", async || first.status().await["counters"]["delivered"].as_u64() > Some(0)).await;
        Self { names: chain.names, switches, period_ms }
    }
}
