//! The architectures of packages, in the words of Debian, Rust and the OCI.

/// An architecture that packages are made for.
#[derive(Clone, Copy, PartialEq, Eq, Debug, clap::ValueEnum)]
pub enum Arch {
    Amd64,
    Arm64,
}

impl Arch {
    /// Debian's name, which is also that of the OCI.
    pub fn debian(self) -> &'static str {
        match self {
            Self::Amd64 => "amd64",
            Self::Arm64 => "arm64",
        }
    }

    /// Returns the target of rustc.
    pub fn target(self) -> &'static str {
        match self {
            Self::Amd64 => "x86_64-unknown-linux-gnu",
            Self::Arm64 => "aarch64-unknown-linux-gnu",
        }
    }

    /// Returns whether this machine runs its executables.
    pub fn is_native(self) -> bool {
        cfg!(target_arch = "x86_64") == (self == Self::Amd64)
    }
}
