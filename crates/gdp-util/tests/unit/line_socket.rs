//! The admin socket against many clients, over real sockets.

use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream as Client;

use futures_util::stream;

use super::*;

struct Echo;

impl Answering for Echo {
    const MAX_LINE: usize = 100;

    async fn answer(&self, line: Vec<u8>) -> Answer {
        let line = String::from_utf8(line).unwrap();
        match line.as_str() {
            "watch\n" => Answer::Watch { first: "watching\n".into(), lines: Box::pin(stream::pending()) },
            _ => Answer::Line(line),
        }
    }

    fn refuse(&self, why: Unanswered) -> String {
        format!("{why}\n")
    }
}

/// A runtime of its own, so that clients may block.
struct Server {
    folder: tempfile::TempDir,
    _listening: Listening,
    _runtime: tokio::runtime::Runtime,
}

impl Server {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let _entered = runtime.enter();
        let (listening, listener) = listen(&folder.path().join("test.sock")).unwrap();
        runtime.spawn(serve(listener, Echo));
        drop(_entered);
        Self { folder, _listening: listening, _runtime: runtime }
    }

    fn path(&self) -> PathBuf {
        self.folder.path().join("test.sock")
    }

    /// Sends a line, and returns the connection and what came back.
    fn ask(&self, line: &str) -> (Client, String) {
        let mut client = Client::connect(self.path()).unwrap();
        client.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        // A client without a slot may find the connection half closed.
        _ = client.write_all(line.as_bytes());
        let mut answer = String::new();
        BufReader::new(&client).read_line(&mut answer).unwrap();
        (client, answer)
    }
}

#[test]
fn watchers_leave_room_for_commands() {
    let server = Server::start();
    let watchers: Vec<_> = (0..MAX_WATCHERS).map(|_| server.ask("watch\n")).collect();
    assert!(watchers.iter().all(|(_, answer)| answer == "watching\n"));
    assert_eq!(server.ask("watch\n").1, format!("{}\n", Unanswered::NoWatcherSlot));
    assert_eq!(server.ask("status\n").1, "status\n");
    // A watcher that leaves makes room.
    drop(watchers);
    let deadline = Instant::now() + Duration::from_secs(10);
    while server.ask("watch\n").1 != "watching\n" {
        assert!(Instant::now() < deadline, "the slots stay taken");
    }
}

#[test]
fn a_client_beyond_the_limit_is_refused_with_the_reason() {
    let server = Server::start();
    let idle: Vec<_> = (0..MAX_COMMANDS).map(|_| server.ask("hello\n")).collect();
    assert!(idle.iter().all(|(_, answer)| answer == "hello\n"));
    assert_eq!(server.ask("status\n").1, format!("{}\n", Unanswered::NoSlot));
    drop(idle);
    let deadline = Instant::now() + Duration::from_secs(10);
    while server.ask("status\n").1 != "status\n" {
        assert!(Instant::now() < deadline, "the slots stay taken");
    }
}

#[test]
fn a_line_without_an_end_is_refused() {
    let server = Server::start();
    assert_eq!(server.ask(&"x".repeat(1000)).1, format!("{}\n", Unanswered::TooLong(100)));
}

#[test]
fn the_socket_is_for_user_and_group_and_has_one_program() {
    let server = Server::start();
    assert_eq!(std::fs::metadata(server.path()).unwrap().permissions().mode() & 0o777, 0o660);
    let _entered = server._runtime.enter();
    assert!(matches!(listen(&server.path()), Err(SocketError::InUse(_))));
    let file = server.folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    assert!(matches!(listen(&file), Err(SocketError::NotASocket(_))));
}

#[test]
fn of_programs_that_start_together_one_gets_the_socket() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("test.sock");
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    for round in 0..30 {
        // A crashed program has left its file.
        drop(std::os::unix::net::UnixListener::bind(&path).unwrap());
        let start = std::sync::Barrier::new(4);
        let started: Vec<_> = std::thread::scope(|scope| {
            let program = || {
                let _entered = runtime.enter();
                start.wait();
                listen(&path)
            };
            let programs: Vec<_> = (0..4).map(|_| scope.spawn(program)).collect();
            programs.into_iter().map(|program| program.join().unwrap()).collect()
        });
        let (opened, refused): (Vec<_>, Vec<_>) = started.into_iter().partition(Result::is_ok);
        assert_eq!(opened.len(), 1, "round {round}");
        assert!(refused.iter().all(|refused| matches!(refused, Err(SocketError::InUse(_)))), "{refused:?}");
        assert!(Client::connect(&path).is_ok(), "round {round}");
    }
}

#[test]
fn a_folder_that_stays_locked_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let _locked = take_turn(folder.path(), Duration::ZERO).unwrap().unwrap();
    assert!(take_turn(folder.path(), Duration::from_millis(20)).unwrap().is_none());
}
