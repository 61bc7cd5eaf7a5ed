//! The package for Python: its pytest at a real switch, and programs in Rust and Python that
//! exchange messages with nodes of rclpy. No root.

mod installed;
mod ros;
mod site;

use std::path::Path;
use std::process::Command;

use installed::Installed;
use site::Site;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pytest_passes_at_a_real_switch() {
    let site = Site::new().await;
    let (robot, laptop) = (site.keyring("robot"), site.keyring("laptop"));
    for (kind, name, of) in [
        ("topic", "/bytes", "bytes"),
        ("topic", "/text", "std_msgs/msg/String"),
        ("topic", "/scan", "sensor_msgs/msg/LaserScan"),
        ("topic", "/image", "sensor_msgs/msg/Image"),
        ("topic", "/twist", "geometry_msgs/msg/Twist"),
        ("service", "/light", "bytes"),
    ] {
        let card = site.card(kind, name, of);
        site.allow(&card, &[&robot], &[&laptop]);
    }
    let mut pytest = site.python();
    pytest.args(["-m", "pytest", "-q", "-p", "no:cacheprovider", concat!(env!("CARGO_MANIFEST_DIR"), "/tests")]);
    pytest.env("GDP_TEST_SWITCH", site.switch()).env("GDP_TEST_KEYRINGS", site.folder());
    tokio::task::spawn_blocking(move || passes(&mut pytest)).await.unwrap();
}

#[test]
fn the_types_are_those_of_the_extension_module() {
    let folder = tempfile::tempdir().unwrap();
    let installed = Installed::new(folder.path());
    let mypy = |module: &str, arguments: &[&str]| {
        let mut python = installed.python();
        python.args(["-m", module]).args(arguments).current_dir(folder.path());
        passes(&mut python);
    };
    mypy("mypy.stubtest", &["gdp"]);
    let strict = ["--strict", "--cache-dir=/dev/null"];
    mypy("mypy", &[&strict[..], &["-p", "gdp"]].concat());
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let programs = ["examples/ros_listener.py", "examples/ros_talker.py", "tests/test_sdk.py"];
    let programs = programs.map(|program| here.join(program).to_str().unwrap().to_owned());
    mypy("mypy", &[&strict[..], &programs.each_ref().map(String::as_str)].concat());
}

fn passes(command: &mut Command) {
    let output = command.output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    println!("{text}");
}
