//! Unit tests of `cli::home::fleet`.

use gdp_tests::book::{file_keys, files, reference};

use super::*;

#[test]
fn the_reference_page_has_the_keys_of_this_file() {
    let introduction = "These are the keys of the file of `gdp-ctl apply -f FILE`. It is YAML, and unknown keys are \
                        errors. [A domain day by day](../operate.md#a-fleet-in-one-file) has an example.";
    let page = file_keys::write("The file of a fleet", introduction, &schemars::schema_for!(Fleet).into());
    reference::check("docs/reference/fleet-file.md", &page);
}

#[test]
fn the_files_in_documents_are_good() {
    for (at, text) in files("fleet.yaml").unwrap() {
        let fleet: Fleet = serde_saphyr::from_str(&text).unwrap_or_else(|error| panic!("{at}: {error}"));
        assert_eq!(fleet.version, 1, "{at}");
    }
}
