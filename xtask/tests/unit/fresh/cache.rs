//! Unit tests of `fresh::cache`.

use super::*;

fn with_a_crate(folder: &Path) -> PathBuf {
    let file = folder.join("crates/index/a");
    fs::create_dir_all(file.parent().expect("a folder")).expect("created");
    fs::write(&file, "x").expect("written");
    file
}

#[test]
fn a_run_that_did_not_come_to_its_end_leaves_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let cache = Cache::open(folder.path()).expect("a cache");
    let file = with_a_crate(folder.path());
    cache.complete().expect("complete");
    drop(cache);
    // This one ends badly.
    drop(Cache::open(folder.path()).expect("a cache"));
    assert!(file.exists(), "what a good run leaves is there for the next");
    drop(Cache::open(folder.path()).expect("a cache"));
    assert!(!file.exists(), "what a bad run leaves may be broken");
}

#[test]
fn what_is_too_large_is_removed() {
    let folder = tempfile::tempdir().expect("a folder");
    let cache = Cache::open(folder.path()).expect("a cache");
    let file = with_a_crate(folder.path());
    let part = PARTS.iter().find(|part| part.name == "crates").expect("a part");
    // Sparse.
    File::create(&file).and_then(|file| file.set_len(part.limit + 1)).expect("large");
    cache.complete().expect("complete");
    drop(cache);
    drop(Cache::open(folder.path()).expect("a cache"));
    assert!(!file.exists());
}

#[test]
fn compiled_files_are_of_one_table_of_setup_steps() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut cache = Cache::open(folder.path()).expect("a cache");
    let compiled = |key: &str| Compiled { key: key.to_owned() };
    cache.use_compiled(&compiled("a")).expect("used");
    let file = folder.path().join("compiled/release/a");
    fs::write(&file, "x").expect("written");
    cache.use_compiled(&compiled("a")).expect("used");
    assert!(file.exists());
    cache.use_compiled(&compiled("b")).expect("used");
    assert!(!file.exists());
    let mounts = cache.mounts("root/gdp");
    assert!(mounts.contains(&(folder.path().join("compiled/release"), "root/gdp/target/release".to_owned())));
}
