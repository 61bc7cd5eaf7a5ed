//! Paths of the programs under test. A missing program is named before anything starts.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};

/// The executables of this project, and the foreign DDS programs.
#[derive(Clone, Debug)]
pub struct Tools {
    executables: PathBuf,
    target: PathBuf,
    ebpf_object: &'static str,
    /// Whether daemons load the programs that their executable embeds.
    embedded: bool,
}

impl Tools {
    /// Creates the set of tools. `executables`: the folder of `gdp-ctl` and `gdp-proxy`; `target`:
    /// Cargo's target folder.
    pub fn new(executables: PathBuf, target: PathBuf) -> Self {
        Self { executables, target, ebpf_object: "gdp-ebpf", embedded: false }
    }

    /// Returns the same tools with the executables of a package, whose daemons load their own XDP
    /// programs.
    pub fn of_package(&self, executables: PathBuf) -> Self {
        Self { executables, embedded: true, ..self.clone() }
    }

    /// Returns the tools for a test: the executables of the test's own build profile
    /// (`target/PROFILE/deps/TEST`).
    pub fn beside_this_test() -> Result<Self> {
        let test = std::env::current_exe()?;
        match (test.ancestors().nth(2), test.ancestors().nth(3)) {
            (Some(executables), Some(target)) => Ok(Self::new(executables.into(), target.into())),
            _ => bail!("{} is not in a target folder", test.display()),
        }
    }

    pub fn gdp_ctl(&self) -> Result<PathBuf> {
        existing(self.executables.join("gdp-ctl"), "cargo xtask build")
    }

    pub fn gdp_proxy(&self) -> Result<PathBuf> {
        existing(self.executables.join("gdp-proxy"), "cargo xtask build")
    }

    pub fn ebpf_object(&self) -> Result<PathBuf> {
        existing(self.target.join("bpf").join(self.ebpf_object), "cargo xtask test")
    }

    /// Returns the object that daemons load in place of the one that they embed, if any.
    pub fn loaded_object(&self) -> Result<Option<PathBuf>> {
        (!self.embedded).then(|| self.ebpf_object()).transpose()
    }

    /// Returns the object with the programs that benchmarks and tests attach around the switch.
    pub fn ebpf_bench_object(&self) -> Result<PathBuf> {
        existing(self.target.join("bpf/bpfel-unknown-none/release/gdp-ebpf-bench"), "cargo xtask build")
    }

    /// Uses another build of the XDP programs, from the same source, from now on.
    pub fn rebuild(&mut self) -> Result<()> {
        let before = std::fs::read(self.ebpf_object()?)?;
        self.ebpf_object = "gdp-ebpf-rebuilt";
        ensure!(std::fs::read(self.ebpf_object()?)? != before, "the other build made the same");
        Ok(())
    }

    /// Returns the path of the compiled Fast DDS peer.
    pub fn fastdds(&self) -> Result<PathBuf> {
        existing(self.target.join("peers/fastdds-peer"), "cargo xtask test")
    }

    /// Returns the path of the Python that has Cyclone DDS.
    pub fn python(&self) -> Result<PathBuf> {
        existing(self.target.join("venv/bin/python"), "cargo xtask setup")
    }

    /// Returns the path of the Python of the SDK's tests.
    pub fn python_of_sdk(&self) -> Result<PathBuf> {
        existing(self.target.join("venv-sdk/bin/python"), "cargo xtask setup")
    }

    /// Returns the path of the Python that runs the endpoint of `conformance/`.
    pub fn python_of_conformance(&self) -> Result<PathBuf> {
        existing(self.target.join("venv-conformance/bin/python"), "cargo xtask setup")
    }

    /// Makes the package `gdp` for Python in a folder, as `pip` installs it.
    pub fn install_python_sdk(&self, folder: &Path) -> Result<()> {
        let package = folder.join("gdp");
        std::fs::create_dir_all(&package)?;
        let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("../gdp-python/python/gdp");
        for entry in std::fs::read_dir(sources)? {
            let file = entry?.path();
            if let (true, Some(name)) = (file.is_file(), file.file_name()) {
                std::fs::copy(&file, package.join(name))?;
            }
        }
        let extension = existing(self.executables.join("deps/libgdp_python.so"), "cargo xtask test")?;
        std::fs::copy(extension, package.join("_gdp.abi3.so"))?;
        Ok(())
    }

    /// Returns the path of the Cyclone DDS peer, run by [`Tools::python`].
    pub fn cyclone(&self) -> PathBuf {
        self.peer("cyclone.py")
    }

    /// Returns the path of a program in `tests/peers` that needs no compiler.
    pub fn peer(&self, file: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("peers").join(file)
    }

    /// Returns the path of the compiled QUIC peer.
    pub fn quic(&self) -> Result<PathBuf> {
        existing(self.executables.join("examples/quic-peer"), "cargo xtask bench wire")
    }

    /// Returns the path of the compiled Fast DDS peer that exchanges any type.
    pub fn fastdds_any(&self) -> Result<PathBuf> {
        existing(self.target.join("peers/fastdds-any"), "cargo xtask test")
    }
}

fn existing(file: PathBuf, remedy: &str) -> Result<PathBuf> {
    if file.is_file() { Ok(file) } else { bail!("{} does not exist: run `{remedy}`", file.display()) }
}
