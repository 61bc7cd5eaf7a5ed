//! Unit tests of `manager`.

use parking_lot::Mutex;

use super::*;

/// A place, and what makes another of it.
#[derive(Clone, Debug, PartialEq)]
struct Toy(u8, &'static str);

struct Running {
    toy: Toy,
    told: Told,
}

type Told = Arc<Mutex<Vec<String>>>;

impl Plan for Toy {
    type Key = u8;
    type Work = Running;

    fn key(&self) -> u8 {
        self.0
    }
}

impl Running {
    fn tell(&self, what: &str) {
        self.told.lock().push(format!("{what} {}{}", self.toy.0, self.toy.1));
    }
}

impl Work for Running {
    type Stats = Toy;

    fn stats(&self) -> Toy {
        self.toy.clone()
    }

    fn failed(&self, why: &str) {
        self.tell(why);
    }

    async fn run(&self, stop: impl Future<Output = ()> + Send) -> Result<(), Failure> {
        match self.toy.1 {
            "fails" => return Err(Failure::Passing("failed".into())),
            "breaks" => return Err(Failure::Final(anyhow::anyhow!("broken"))),
            _ => self.tell("begin"),
        }
        stop.await;
        self.tell("end");
        Ok(())
    }
}

fn manager() -> (Manager<Toy>, Told) {
    let told = Told::default();
    let theirs = told.clone();
    (Manager::new(move |toy: &Toy| Running { toy: toy.clone(), told: theirs.clone() }), told)
}

/// Until all that is said has been told; works follow one another meanwhile.
async fn until(manager: &mut Manager<Toy>, told: &Told, expected: &[&str]) {
    let told = async {
        while !expected.iter().all(|line| told.lock().iter().any(|told| told == line)) {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    };
    let patience = tokio::time::timeout(Duration::from_secs(20), told);
    tokio::select! {
        in_time = patience => in_time.unwrap(),
        error = manager.failed() => panic!("{error}"),
    }
}

#[tokio::test]
async fn what_is_wanted_as_it_is_goes_on_and_the_rest_begins_ends_or_begins_anew() {
    let (mut manager, told) = manager();
    let changed = manager.want([Toy(1, "a"), Toy(2, "a"), Toy(3, "a")]);
    assert_eq!(changed, ChangeCounts { begun: 3, ended: 0, unchanged: 0 });
    until(&mut manager, &told, &["begin 1a", "begin 2a", "begin 3a"]).await;

    let changed = manager.want([Toy(1, "a"), Toy(2, "b"), Toy(4, "a")]);
    assert_eq!(changed, ChangeCounts { begun: 2, ended: 2, unchanged: 1 });
    until(&mut manager, &told, &["end 3a", "begin 2b", "begin 4a"]).await;
    let log = told.lock().clone();
    let at = |line: &str| log.iter().position(|told| told == line);
    assert!(at("end 2a") < at("begin 2b") && at("end 1a").is_none(), "{log:?}");
    assert_eq!(manager.stats(), [Toy(1, "a"), Toy(2, "b"), Toy(4, "a")]);

    assert_eq!(manager.close().await, [Toy(1, "a"), Toy(2, "b"), Toy(4, "a")]);
    assert_eq!(told.lock().iter().filter(|line| line.starts_with("end")).count(), 5);
}

#[tokio::test]
async fn what_is_unwanted_while_another_ends_never_begins() {
    let (mut manager, told) = manager();
    manager.want([Toy(1, "a")]);
    until(&mut manager, &told, &["begin 1a"]).await;
    manager.want([Toy(1, "b")]);
    manager.want([Toy(1, "a")]);
    manager.want([]);
    manager.close().await;
    assert_eq!(*told.lock(), ["begin 1a", "end 1a"]);
}

#[tokio::test]
async fn a_failure_ends_neither_the_others_nor_the_manager_unless_nothing_else_mends_it() {
    let (mut manager, told) = manager();
    manager.want([Toy(1, "a"), Toy(2, "fails")]);
    until(&mut manager, &told, &["begin 1a", "failed 2fails"]).await;
    assert_eq!(manager.stats().len(), 2);
    manager.want([Toy(1, "a"), Toy(3, "breaks")]);
    let error = tokio::time::timeout(Duration::from_secs(20), manager.failed()).await.unwrap();
    assert_eq!(error.to_string(), "broken");
    manager.close().await;
    assert!(told.lock().iter().any(|line| line == "end 1a"));
}
