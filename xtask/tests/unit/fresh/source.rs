//! Unit tests of `fresh::source`.

use super::*;

#[test]
fn only_files_whose_content_has_changed_are_new() {
    let folder = tempfile::tempdir().expect("a folder");
    let (tree, record) = (folder.path().join("tree"), folder.path().join("record"));
    let git = |arguments: &[&str]| {
        let mut git = Program::Git.command();
        execute(git.args(["-c", "user.name=t", "-c", "user.email=t@t"]).args(arguments).current_dir(&tree))
            .expect("git")
    };
    let time = |file: &str| fs::metadata(tree.join(file)).and_then(|file| file.modified()).expect("a time");
    fs::create_dir(&tree).expect("a folder");
    git(&["init", "--quiet"]);
    let (same, changed) = ("a file", "b");
    for file in [same, changed] {
        fs::write(tree.join(file), file).expect("written");
    }
    git(&["add", "."]);
    restore_times(&tree, &record).expect("recorded");
    // As if the first run had been long ago.
    let old = fs::read_to_string(&record).expect("a record");
    let old = old.lines().filter_map(|line| Some(format!("1000 {}\n", line.split_once(' ')?.1)));
    fs::write(&record, old.collect::<String>()).expect("written");
    fs::write(tree.join(changed), "other").expect("written");
    git(&["add", "."]);
    restore_times(&tree, &record).expect("restored");
    assert_eq!(time(same), UNIX_EPOCH + Duration::from_secs(1000));
    assert!(time(changed) > UNIX_EPOCH + Duration::from_secs(1000));
}
