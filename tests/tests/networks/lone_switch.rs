//! One switch with the RIB, and another host on its only cable:
//!
//! ```text
//!  host l0 ──── e0 remote
//! ```

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use gdp_tests::Tools;
use gdp_tests::fabric::Mounted;
use gdp_tests::netns::{End, Namespace, execute, veth};
use gdp_tests::process::Process;
use gdp_tests::programs::own;
use gdp_tests::wait::{TIMEOUT, wait_for};
use serde_json::{Value, json};

/// A host whose daemon has everything that a fabric needs, and a second host.
pub struct LoneSwitch {
    pub daemon: Process,
    pub host: Namespace,
    pub remote: Namespace,
    pub tools: Tools,
    _bpffs: Mounted,
    folder: tempfile::TempDir,
}

impl LoneSwitch {
    pub fn build(data_plane: &str) -> Result<Self> {
        let (host, remote) = (Namespace::create("host")?, Namespace::create("remote")?);
        let end = |namespace, interface, number| End { namespace, interface, mac: [2, 0, 0, 0, 0, number] };
        veth(&end(&host, "l0", 1), &end(&remote, "e0", 2), 1500)?;
        host.ip(&["addr", "add", "10.9.0.1/24", "dev", "l0"])?;
        let folder = tempfile::Builder::new().prefix("gdp-lone-switch-").tempdir()?;
        let bpffs = folder.path().join("bpf");
        let config = json!({
            "identity": folder.path().join("switch.pem"),
            "socket": folder.path().join("switch.sock"),
            "interfaces": ["l0"],
            "udp": "0.0.0.0:31415",
            "data_plane": data_plane,
            "bpffs": bpffs,
            "rib": true,
        });
        fs::write(folder.path().join("switch.yaml"), config.to_string())?;
        let tools = Tools::beside_this_test()?;
        let daemon = serve(&tools, &host, folder.path().to_owned())?;
        let site = Self { daemon, host, remote, tools, _bpffs: Mounted(bpffs), folder };
        site.wait_until_up()?;
        Ok(site)
    }

    /// Starts another daemon after one has ended.
    pub fn start(&mut self) -> Result<()> {
        self.daemon = serve(&self.tools, &self.host, self.folder.path().to_owned())?;
        self.wait_until_up()
    }

    fn wait_until_up(&self) -> Result<()> {
        let up = || self.daemon.stderr().contains("ready: switch ");
        wait_for("the daemon to take links", TIMEOUT, || Ok(up().then_some(()))).with_context(|| self.report())
    }

    pub fn status(&self) -> Result<Value> {
        let mut command = own(self.tools.gdp_ctl()?);
        command.args(["status", "-j", "--socket"]).arg(self.path("switch.sock"));
        Ok(serde_json::from_str(&execute(&mut command)?)?)
    }

    /// Returns the interfaces that are ends of a pair.
    pub fn ends(&self) -> Result<Vec<String>> {
        let links: Value = serde_json::from_str(&self.host.ip(&["-j", "link", "show"])?)?;
        let names = links.as_array().into_iter().flatten().filter_map(|link| link["ifname"].as_str());
        Ok(names.filter(|name| name.starts_with("gdp")).map(str::to_owned).collect())
    }

    pub fn bpffs(&self) -> PathBuf {
        self.path("bpf")
    }

    /// Returns the path of a file in the folder of this host.
    pub fn path(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    pub fn report(&self) -> String {
        let shown = [["addr", "show"], ["neigh", "show"], ["route", "show"]].map(|show| self.host.ip(&show));
        let status = self.status().map(|status| status.to_string());
        format!("{}\n{status:?}\n{}", self.daemon.report(), shown.into_iter().flatten().collect::<String>())
    }
}

fn serve(tools: &Tools, host: &Namespace, folder: PathBuf) -> Result<Process> {
    let mut command = host.command(tools.gdp_ctl()?)?;
    command.args(["serve", "--config"]).arg(folder.join("switch.yaml")).env("GDP_EBPF_OBJECT", tools.ebpf_object()?);
    Process::spawn("switch", command, &folder)
}
