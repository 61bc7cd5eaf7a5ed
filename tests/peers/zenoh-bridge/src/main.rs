//! A zenoh router with the ROS 2 plugin, equivalent to `zenoh-bridge-ros2dds`: `zenoh-bridge
//! CONFIG`.

use anyhow::{Context, Result, anyhow};
use zenoh::config::Config;
use zenoh::internal::plugins::PluginsManager;
use zenoh::internal::runtime::RuntimeBuilder;
use zenoh_plugin_ros2dds::ROS2Plugin;

fn main() -> Result<()> {
    let file = std::env::args().nth(1).context("which configuration?")?;
    tokio::runtime::Builder::new_multi_thread().enable_all().build()?.block_on(async {
        zenoh::init_log_from_env_or("warn");
        let failed = |error: zenoh::Error| anyhow!(error.to_string());
        let mut plugins = PluginsManager::static_plugins_only();
        plugins.declare_static_plugin::<ROS2Plugin, &str>("ros2dds", true);
        let config = Config::from_file(file).map_err(failed)?;
        let mut runtime = RuntimeBuilder::new(config).plugins_manager(plugins).build().await.map_err(failed)?;
        runtime.start().await.map_err(failed)?;
        let _session = zenoh::session::init(runtime.into()).await.map_err(failed)?;
        println!(r#"{{"event":"ready"}}"#);
        std::future::pending().await
    })
}
