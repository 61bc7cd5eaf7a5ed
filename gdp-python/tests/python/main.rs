//! The package for Python: its pytest at a real switch, and programs in Rust and Python that
//! exchange messages with nodes of rclpy. No root.

mod ros;
mod site;

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
    let mut pytest = site.python("venv-sdk");
    pytest.args(["-m", "pytest", "-q", "-p", "no:cacheprovider", concat!(env!("CARGO_MANIFEST_DIR"), "/tests")]);
    pytest.env("GDP_TEST_SWITCH", site.switch()).env("GDP_TEST_KEYRINGS", site.folder());
    let output = tokio::task::spawn_blocking(move || pytest.output().unwrap()).await.unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    println!("{text}");
}
