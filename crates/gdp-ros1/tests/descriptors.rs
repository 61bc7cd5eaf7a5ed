//! A node whose peers take as many open files as they can. The limit is that of the whole process,
//! so this test has one of its own.

#[path = "rospy/harness.rs"]
#[allow(dead_code, reason = "the tests of rospy, whose it is, use the rest")]
mod harness;
#[path = "rospy/master.rs"]
#[allow(dead_code, reason = "the tests of rospy, whose it is, use the rest")]
mod master;

use std::fs::{self, File};
use std::sync::Arc;
use std::time::Duration;

use gdp_ros1::{PublishOptions, Publisher};
use gdp_util::descriptors::RESERVE;
use parking_lot::Mutex;
use tokio::time::{Instant, sleep};

use harness::{Master, registered, string, string_type, until};

/// Files that this process may open.
const LIMIT: u64 = 160;

/// Connections of the peers.
const CROWD: &str = "200";

/// Connections that are about to be closed again.
const JUST_OPENED: usize = 8;

#[tokio::test]
async fn connections_leave_files_for_the_rest_and_one_line_in_the_log() {
    let log = Log::default();
    let writer = log.clone();
    tracing_subscriber::fmt().with_ansi(false).with_writer(move || writer.clone()).init();
    let master = Master::start().await;
    let node = master.node("/bridge").await;
    let publisher = node.publish("/chatter", string_type(), PublishOptions::default()).unwrap();
    registered(&node).await;
    let (mut early, _) = master.peer("early", &["listen", "/chatter"]).await;
    subscribed(&publisher, 1).await;

    limit_open_files(LIMIT);
    let (mut crowd, _) = master.peer("crowd", &["crowd", "/bridge", "/chatter", CROWD]).await;
    let most = (LIMIT - RESERVE) as usize;
    until("as many connections as are taken", async || (open_files() >= most).then_some(())).await;
    // All that time the peers try again.
    let over = Instant::now() + Duration::from_secs(2);
    while Instant::now() < over {
        assert!(open_files() <= most + JUST_OPENED, "{} of {most} open", open_files());
        sleep(Duration::from_millis(10)).await;
    }
    let files: Result<Vec<_>, _> = (1..RESERVE).map(|_| File::open("/dev/null")).collect();
    files.expect("what connections leave is free for others");
    publisher.publish(string("still here")).unwrap();
    assert_eq!(early.event("message").await["data"], "still here");
    let text = String::from_utf8(log.0.lock().clone()).unwrap();
    let warnings: Vec<&str> = text.lines().filter(|line| line.contains(" WARN ")).collect();
    assert!(warnings.len() == 1 && warnings[0].contains("LimitNOFILE="), "{warnings:#?}");

    crowd.kill();
    let _late = master.begin("late", &["listen", "/chatter"]);
    subscribed(&publisher, 2).await;
}

async fn subscribed(publisher: &Publisher, count: usize) {
    until("subscribers", async || (publisher.subscribers().len() == count).then_some(())).await;
}

fn open_files() -> usize {
    // One is that of the folder itself.
    fs::read_dir("/proc/self/fd").map_or(usize::MAX, |files| files.count() - 1)
}

/// Lowers the soft limit, which a program that is started here can raise again.
fn limit_open_files(soft: u64) {
    let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
    // SAFETY: the call writes to this structure only.
    assert_eq!(unsafe { libc::getrlimit(libc::RLIMIT_NOFILE, &mut limit) }, 0);
    limit.rlim_cur = soft;
    // SAFETY: the call reads this structure only.
    assert_eq!(unsafe { libc::setrlimit(libc::RLIMIT_NOFILE, &limit) }, 0);
}

/// What was logged.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl std::io::Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
