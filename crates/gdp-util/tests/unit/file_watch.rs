//! Unit tests of `file_watch`.

use std::os::unix::fs::{PermissionsExt as _, symlink};

use tokio::time::timeout;

use super::*;

const DEADLINE: Duration = Duration::from_secs(60);

struct Scene {
    folder: tempfile::TempDir,
    watcher: FileWatcher,
}

impl Scene {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap(), watcher: FileWatcher::start() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

async fn is_told(file: &mut WatchedFile, of: &str) {
    timeout(DEADLINE, file.changed()).await.unwrap_or_else(|_| panic!("{of} was not told"));
}

#[tokio::test]
async fn each_way_to_change_a_file_is_told() {
    let scene = Scene::new();
    let path = scene.path("certificate");
    let mut file = scene.watcher.watch(&path);
    fs::write(&path, "one").unwrap();
    is_told(&mut file, "a new file").await;
    fs::write(&path, "two more").unwrap();
    is_told(&mut file, "a file that is written again").await;
    fs::write(scene.path("new"), "three").unwrap();
    fs::rename(scene.path("new"), &path).unwrap();
    is_told(&mut file, "a file that is replaced").await;
    fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
    is_told(&mut file, "other permissions").await;
    fs::remove_file(&path).unwrap();
    is_told(&mut file, "a file that is removed").await;
    assert!(!file.has_changed(), "each change is told once");
}

/// A program replaces its statistics in the same folder each second.
#[tokio::test]
async fn other_files_in_the_folder_are_no_event() {
    let scene = Scene::new();
    let _watched = scene.watcher.watch(&scene.path("certificate"));
    let mut folders = Folders::new();
    folders.follow(scene.watcher.0.shared.files.lock().keys());
    for i in 0..100 {
        fs::write(scene.path("statistics.new"), i.to_string()).unwrap();
        fs::rename(scene.path("statistics.new"), scene.path("statistics")).unwrap();
    }
    assert!(timeout(Duration::from_millis(200), folders.event()).await.is_err());
    fs::write(scene.path("certificate"), "one").unwrap();
    timeout(DEADLINE, folders.event()).await.unwrap();
}

#[tokio::test]
async fn a_folder_that_comes_later_and_a_link_into_another_are_told() {
    let scene = Scene::new();
    let (late, linked) = (scene.path("late/file"), scene.path("linked"));
    fs::create_dir(scene.path("data1")).unwrap();
    fs::write(scene.path("data1/file"), "one").unwrap();
    symlink(scene.path("data1/file"), &linked).unwrap();
    let (mut late_file, mut linked_file) = (scene.watcher.watch(&late), scene.watcher.watch(&linked));
    fs::create_dir(scene.path("late")).unwrap();
    fs::write(&late, "here").unwrap();
    is_told(&mut late_file, "a file in a folder that was made later").await;
    // No event comes of it in the folder of the link.
    fs::write(scene.path("data1/file"), "two").unwrap();
    is_told(&mut linked_file, "a file behind a link").await;
}

#[tokio::test]
async fn a_set_reports_a_file_that_is_replaced_once_and_when_it_is_whole() {
    let scene = Scene::new();
    let paths = [scene.path("certificate"), scene.path("card")];
    paths.iter().for_each(|path| fs::write(path, "one").unwrap());
    let mut set = FileSet::new(&scene.watcher, paths.iter().map(PathBuf::as_path));
    assert!(!set.has_changed());
    for path in &paths {
        fs::write(scene.path("new"), "two").unwrap();
        fs::rename(scene.path("new"), path).unwrap();
        timeout(DEADLINE, set.changed()).await.expect("a file that is replaced is reported");
        assert!(!set.has_changed(), "it is reported once");
    }
    // What is written in steps is one change, and none while it is missing.
    fs::remove_file(&paths[0]).unwrap();
    assert!(!set.has_changed());
    let writes = async {
        for step in 0..8 {
            fs::write(&paths[0], format!("step {step}")).unwrap();
            sleep(QUIET / 4).await;
        }
    };
    let (read, ()) = tokio::join!(
        async {
            timeout(DEADLINE, set.changed()).await.expect("a file that is written is reported");
            fs::read_to_string(&paths[0]).unwrap()
        },
        writes
    );
    assert_eq!(read, "step 7");
}

#[tokio::test]
async fn a_set_forgets_no_change_of_a_file_that_stays_in_it() {
    let scene = Scene::new();
    let [stays, goes, comes] = ["stays", "goes", "comes"].map(|name| scene.path(name));
    let mut set = FileSet::new(&scene.watcher, [stays.as_path(), &goes]);
    fs::write(&stays, "").unwrap();
    fs::write(&goes, "").unwrap();
    set.replace([comes.as_path()]);
    assert!(!set.has_changed());
    set.replace([stays.as_path(), &comes]);
    assert!(!set.has_changed(), "what was not in the set counts as it is now");
    fs::write(&comes, "").unwrap();
    set.replace([comes.as_path()]);
    timeout(DEADLINE, set.changed()).await.expect("the change is not forgotten");
}

#[tokio::test]
async fn what_nobody_watches_any_more_is_forgotten() {
    let scene = Scene::new();
    drop(scene.watcher.watch(&scene.path("gone")));
    let mut stays = scene.watcher.watch(&scene.path("stays"));
    fs::write(scene.path("stays"), "").unwrap();
    is_told(&mut stays, "the other").await;
    assert_eq!(scene.watcher.0.shared.files.lock().len(), 1);
}
