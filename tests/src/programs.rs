//! Every external program that tests, benchmarks and `xtask` start.
//!
//! All of them are started through [`Executable`]: clippy refuses `Command::new` elsewhere
//! (`clippy.toml`), so this list is complete. `cargo xtask setup` installs the listed programs, and
//! `cargo xtask fresh` looks each up on a clean Debian.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

macro_rules! programs {
    ($($(#[$doc:meta])* $variant:ident = $name:literal,)*) => {
        /// A program that is not built from this tree. The name is looked up on `PATH`, unless it
        /// is a path.
        #[derive(Clone, Copy, PartialEq, Eq, Debug)]
        pub enum Program {
            $($(#[$doc])* $variant,)*
        }

        impl Program {
            pub const ALL: &[Self] = &[$(Self::$variant),*];

            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)*
                }
            }
        }
    };
}

programs! {
    AptGet = "apt-get",
    /// Built by setup; possibly only in the folder of `cargo install`.
    BpfLinker = "bpf-linker",
    Cargo = "cargo",
    /// Started by the linker's driver and by build scripts.
    Cc = "cc",
    CcArm64 = "aarch64-linux-gnu-gcc",
    /// A browser without a window, for the page of `gdp-ctl web`.
    Chromium = "chromium",
    Chrt = "chrt",
    Chroot = "chroot",
    /// Started by the build script of Cyclone DDS.
    Cmake = "cmake",
    Cp = "cp",
    Cxx = "c++",
    Debootstrap = "debootstrap",
    DpkgDeb = "dpkg-deb",
    DpdkTestpmd = "dpdk-testpmd",
    Etcd = "etcd",
    Etcdctl = "etcdctl",
    Ethtool = "ethtool",
    Fastddsgen = "fastddsgen",
    Git = "git",
    Gzip = "gzip",
    Ip = "ip",
    Lintian = "lintian",
    Md5sum = "md5sum",
    Mke2fs = "mke2fs",
    Mkfifo = "mkfifo",
    Mount = "mount",
    Nft = "nft",
    Objcopy = "objcopy",
    ObjcopyArm64 = "aarch64-linux-gnu-objcopy",
    Openssl = "openssl",
    /// Started by build scripts as well.
    PkgConfig = "pkg-config",
    /// Installed by setup, possibly only in the folder of `cargo install`.
    Promtool = "promtool",
    Protoc = "protoc",
    /// Debian's Python, which has the modules of ROS 1; `PATH` may list another one first.
    Python3 = "/usr/bin/python3",
    QemuArm64 = "qemu-aarch64-static",
    QemuSystem = "qemu-system-x86_64",
    Readelf = "readelf",
    Rosmaster = "/usr/bin/rosmaster",
    Rustc = "rustc",
    Setpriv = "setpriv",
    Sh = "sh",
    Sleep = "sleep",
    Stdbuf = "stdbuf",
    SystemdAnalyze = "systemd-analyze",
    Tar = "tar",
    Tc = "tc",
    Umount = "umount",
    Unshare = "unshare",
    /// Started by tar.
    Xz = "xz",
    /// Built by setup; possibly only in the folder of `cargo install`.
    Verifpal = "verifpal",
}

impl Program {
    /// Returns the file that `PATH` resolves to. Also searches `/usr/sbin`, which an unprivileged
    /// user's `PATH` omits.
    pub fn find(self) -> Option<PathBuf> {
        let path = std::env::var_os("PATH").unwrap_or_default();
        std::env::split_paths(&path)
            .chain([PathBuf::from("/usr/sbin"), PathBuf::from("/sbin")])
            .map(|folder| folder.join(self.name()))
            .find(|file| file.is_file())
    }
}

/// The source of a command: a [`Program`], or the path of an executable that was built here.
pub trait Executable {
    fn command(&self) -> Command;
}

impl Executable for Program {
    fn command(&self) -> Command {
        start(OsStr::new(self.name()))
    }
}

impl Executable for Path {
    /// Panics if the path is not absolute: a bare name would be another external program.
    fn command(&self) -> Command {
        assert!(self.is_absolute(), "{} is no path of an executable", self.display());
        start(self.as_os_str())
    }
}

impl Executable for PathBuf {
    fn command(&self) -> Command {
        self.as_path().command()
    }
}

impl<T: Executable + ?Sized> Executable for &T {
    fn command(&self) -> Command {
        (**self).command()
    }
}

/// Returns a command for an executable of this workspace: `env!("CARGO_BIN_EXE_…")`.
pub fn own(path: impl AsRef<Path>) -> Command {
    path.as_ref().command()
}

#[expect(clippy::disallowed_methods, reason = "the one place where commands begin")]
fn start(program: &OsStr) -> Command {
    Command::new(program)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[should_panic(expected = "is no path of an executable")]
    fn a_bare_name_is_not_an_executable_of_this_workspace() {
        own("ip");
    }

    #[test]
    fn no_program_is_listed_twice() {
        for (i, program) in Program::ALL.iter().enumerate() {
            let earlier = Program::ALL.iter().take(i).find(|other| other.name() == program.name());
            assert_eq!(earlier, None, "{}", program.name());
        }
    }
}
