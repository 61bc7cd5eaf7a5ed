//! A switch with its RIB, keyrings of entities, and the package as Python finds it.

use std::path::{Path, PathBuf};
use std::process::Command;

use gdp::{Identity, NameCard, SigningKey};
use gdp_daemon::config::Config;
use gdp_daemon::serve::{Running, start};
use gdp_tests::Tools;
use gdp_tests::programs::own;

pub struct Site {
    folder: tempfile::TempDir,
    daemon: Running,
    owner: SigningKey,
}

/// An entity with the folder of its keyring.
pub struct Entity {
    pub folder: PathBuf,
    pub identity: Identity,
}

impl Site {
    pub async fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (key, any_port) = (folder.path().join("switch.pem"), "127.0.0.1:0".parse().unwrap());
        let config = Config { rib: true, fib_capacity: 1024, ..Config::userspace(key, any_port) };
        let daemon = start(config).await.unwrap();
        Tools::beside_this_test().unwrap().install_python_sdk(&folder.path().join("packages")).unwrap();
        Self { folder, daemon, owner: SigningKey::generate().unwrap() }
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub fn switch(&self) -> String {
        format!("udp://{}", self.daemon.udp_addr().unwrap())
    }

    pub fn keyring(&self, label: &str) -> Entity {
        let folder = self.folder.path().join(label);
        std::fs::create_dir(&folder).unwrap();
        let identity = Identity::load_or_generate(&folder.join("id.pem"), "proxy").unwrap();
        Entity { folder, identity }
    }

    pub fn card(&self, kind: &str, name: &str, of: &str) -> NameCard {
        NameCard::create(self.owner.verify_key(), kind, name, of, None).unwrap()
    }

    /// Gives entities the right to publish or serve, and to read or call a name.
    pub fn allow(&self, card: &NameCard, writers: &[&Entity], readers: &[&Entity]) {
        let label = card.get("topic").unwrap().trim_start_matches('/').to_owned();
        let file = |entity: &Entity, ending: &str| entity.folder.join(format!("{label}.{ending}"));
        for writer in writers {
            let ad = self.owner.allow_publish(card, writer.identity.name()).for_days(1).sign().unwrap();
            std::fs::write(file(writer, "ad"), ad.to_pem()).unwrap();
        }
        for reader in readers {
            let grant = self.owner.allow_read(card, reader.identity.name()).for_days(1).sign().unwrap();
            std::fs::write(file(reader, "grant"), grant.to_pem()).unwrap();
        }
        for entity in writers.iter().chain(readers) {
            std::fs::write(file(entity, "card"), card.to_json()).unwrap();
        }
    }

    /// Returns the Python of an environment, with the package.
    pub fn python(&self, environment: &str) -> Command {
        let python = profile().parent().unwrap().join(environment).join("bin/python");
        let mut command = own(existing(python, "cargo xtask setup test"));
        command.env("PYTHONPATH", self.folder.path().join("packages")).env("PYTHONDONTWRITEBYTECODE", "1");
        command
    }
}

/// Cargo's folder of this profile: this test is in `target/PROFILE/deps`.
pub fn profile() -> PathBuf {
    std::env::current_exe().unwrap().ancestors().nth(2).unwrap().into()
}

pub fn existing(file: PathBuf, remedy: &str) -> PathBuf {
    assert!(file.is_file(), "{} does not exist: run `{remedy}`", file.display());
    file
}
