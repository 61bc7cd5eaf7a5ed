//! Unit tests of `package::sbom`.

use super::super::arch::Arch;
use super::*;

fn build() -> Build {
    Build { arch: Arch::Amd64, version: "9.8.7".into(), checked: false, quick: false }
}

fn names(bill: &Value) -> BTreeSet<&str> {
    bill["components"].as_array().unwrap().iter().map(|component| component["name"].as_str().unwrap()).collect()
}

#[test]
fn it_has_what_is_linked_in_and_nothing_else() {
    let proxy = bill("gdp-proxy", &build()).unwrap();
    let linked = names(&proxy);
    for name in ["aws-lc-sys", "rustls", "rustdds", "gdp-wire", "gdp-ebpf", "aya-ebpf", "zenoh"] {
        assert!(linked.contains(name), "{name}");
    }
    // Macros, build scripts, tests, and another executable.
    for name in ["serde_derive", "cc", "gdp-tests", "tempfile", "gdp-ctl", "gdp-proxy"] {
        assert!(!linked.contains(name), "{name}");
    }
    assert_eq!(proxy["metadata"]["component"]["name"], "gdp-proxy");
    assert_eq!(proxy["metadata"]["component"]["version"], "9.8.7");
    let ctl = bill("gdp-ctl", &build()).unwrap();
    assert!(names(&ctl).contains("gdp-ebpf") && !names(&ctl).contains("rustdds"));
}

#[test]
fn each_component_can_be_looked_up_and_each_reference_leads_to_one() {
    let bill = bill("gdp-proxy", &build()).unwrap();
    assert_eq!((&bill["bomFormat"], &bill["specVersion"]), (&json!("CycloneDX"), &json!("1.5")));
    let components = bill["components"].as_array().unwrap();
    for component in components {
        let (name, own) = (component["name"].as_str().unwrap(), component["purl"].is_null());
        assert_eq!(own, name.starts_with("gdp-") || name == "gdp", "{name}");
        let license = component["licenses"][0]["expression"].as_str().unwrap();
        assert!(!license.is_empty() && !license.contains('/') && license.trim() == license, "{license}");
        match component["hashes"][0]["content"].as_str() {
            Some(sha256) => assert!(sha256.len() == 64 && !own, "{name}"),
            None => assert!(own || name == "rustdds", "{name}"),
        }
    }
    let listed = components.iter().chain([&bill["metadata"]["component"]]).map(|one| one["bom-ref"].as_str().unwrap());
    let references: Vec<&str> = listed.collect();
    let unique: BTreeSet<&str> = references.iter().copied().collect();
    assert_eq!(references.len(), unique.len());
    let dependencies = bill["dependencies"].as_array().unwrap();
    assert_eq!(dependencies.len(), unique.len());
    for dependency in dependencies {
        let below = dependency["dependsOn"].as_array().unwrap().iter().chain([&dependency["ref"]]);
        below.for_each(|reference| assert!(unique.contains(reference.as_str().unwrap()), "{reference}"));
    }
}

#[test]
fn a_crate_without_a_licence_has_no_bill() {
    assert!(CrateGraph::parse("0|top v1.0.0 (/top)|MIT\n1|below v0.1.0|").is_err());
    assert!(CrateGraph::parse("0|top v1.0.0 (/top)|MIT\n3|below v0.1.0|MIT").is_err());
    let graph = CrateGraph::parse("0|top v1.0.0 (/top)|MIT\n1|below v0.1.0|MIT / Apache-2.0\n").unwrap();
    assert_eq!(graph.crates["below@0.1.0"].license, "MIT OR Apache-2.0");
    assert_eq!(graph.dependencies["top@1.0.0"], BTreeSet::from(["below@0.1.0".to_owned()]));
}
