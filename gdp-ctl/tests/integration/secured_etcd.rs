//! Replicas on an etcd that requires TLS, a client certificate, a user and a password. The tests
//! also check a replica's errors if one of them is missing.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use gdp_daemon::config::{Config, EtcdConfig};
use gdp_daemon::serve::start;
use gdp_daemon::store::{Access, ClientCertificate, Login, Tls, client::EtcdClient, items::Copy, items::KeySpace};
use gdp_rib::rib::Item;
use gdp_wire::Name;
use rcgen::{BasicConstraints, CertificateParams, IsCa, Issuer, KeyPair};
use tempfile::TempDir;
use tokio::time::timeout;

use crate::cluster::{Certificates, Cluster};
use crate::switch::{config, wait};

const PASSWORD: &str = "correct horse";
const PREFIX: &str = "test/rib";

#[tokio::test(flavor = "multi_thread")]
async fn replicas_work_on_an_etcd_that_demands_certificates_and_passwords() {
    let site = Site::new();
    let (place, mut client) = (KeySpace::new(PREFIX), site.client(&site.access()));
    let copy = Copy::list(&place, &mut client).await.unwrap();
    let mut watch = client.watch(place.prefix(), copy.revision() + 1).await.unwrap();
    let lease = client.grant(300).await.unwrap();
    let term = place.stand(&mut client, &Name::from_bytes([1; 32]), lease).await.unwrap().expect("nobody leads");
    assert!(client.keep_alive(lease).await.unwrap());
    let mut writer = copy.into_writer(site.client(&site.access()), term);
    writer.write(&[(Item::Invitation(1), Some(b"a".to_vec()))]).await.unwrap();
    let followed = timeout(Duration::from_secs(30), watch.next()).await.expect("there is a leader").unwrap();
    assert!(!followed.is_empty());
    let copy = Copy::list(&place, &mut client).await.unwrap();
    assert_eq!(copy.get(&Item::Invitation(1)), Some(&b"a"[..]));
    client.revoke(lease).await.unwrap();

    let etcd = EtcdConfig { endpoints: site.cluster.endpoints(), prefix: PREFIX.into(), access: site.access() };
    let switch = start(Config { etcd: Some(etcd), ..config(site.folder.path(), "s1") }).await.unwrap();
    wait("a daemon leads", async || place.has_leader(&mut site.client(&site.access())).await.unwrap()).await;
    switch.resign().await;
    assert!(!place.has_leader(&mut client).await.unwrap());
    switch.stop().await;
}

#[tokio::test]
async fn what_etcd_refuses_is_named() {
    let site = Site::new();
    let wrong = secret(&site.folder.path().join("wrong"), "battery staple\n");
    let login = |password_file: &Path| Some(Login { user: "gdp".into(), password_file: password_file.into() });
    let refused = site.refused(&Access { login: login(&wrong), ..site.access() }).await;
    assert!(refused.contains("authentication failed") && refused.contains("\"gdp\""), "{refused}");
    assert!(refused.contains(wrong.to_str().unwrap()) && !refused.contains("battery"), "{refused}");

    let tls = |change: &dyn Fn(&mut Tls)| {
        let mut access = site.access();
        access.tls.iter_mut().for_each(change);
        access
    };
    let refused = site.refused(&tls(&|tls| tls.client = None)).await;
    assert!(refused.contains("etcd.cert") && refused.contains("certificate"), "{refused}");

    let other = Authority::new(site.folder.path(), "other");
    let refused = site.refused(&tls(&|tls| tls.ca = other.file.clone())).await;
    assert!(refused.contains("etcd.ca") && refused.contains(other.file.to_str().unwrap()), "{refused}");

    let strange = other.certify(site.folder.path(), "strange");
    let refused = site.refused(&tls(&|tls| tls.client = Some(strange.clone()))).await;
    assert!(refused.contains(strange.cert.to_str().unwrap()), "{refused}");

    let refused = site.refused(&Access { login: None, ..site.access() }).await;
    assert!(refused.contains("etcd.user is not set"), "{refused}");
}

#[tokio::test]
async fn a_renewed_certificate_is_read_at_the_next_connection() {
    let site = Site::new();
    let (place, mut client) = (KeySpace::new(PREFIX), site.client(&site.access()));
    let files = [&site.client.cert, &site.client.key];
    let valid = files.map(|file| fs::read(file).unwrap());
    let strange = Authority::new(site.folder.path(), "other").certify(site.folder.path(), "strange");
    fs::copy(&strange.cert, files[0]).unwrap();
    fs::copy(&strange.key, files[1]).unwrap();
    Copy::list(&place, &mut client).await.expect_err("etcd knows no such authority");
    files.iter().zip(valid).for_each(|(file, content)| fs::write(file, content).unwrap());
    Copy::list(&place, &mut client).await.expect("the client reads the files again");
}

#[test]
fn files_that_others_may_read_or_that_hold_something_else_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let ca = Authority::new(folder.path(), "ca");
    let client = ca.certify(folder.path(), "client");
    let password_file = secret(&folder.path().join("password"), PASSWORD);
    let access = Access {
        tls: Some(Tls { ca: ca.file.clone(), client: Some(client.clone()) }),
        login: Some(Login { user: "gdp".into(), password_file: password_file.clone() }),
    };
    let endpoint = "https://127.0.0.1:1".parse().unwrap();
    let read =
        || EtcdClient::new(std::slice::from_ref(&endpoint), &access).map(drop).map_err(|error| error.to_string());
    read().unwrap();
    for path in [&client.key, &password_file] {
        fs::set_permissions(path, fs::Permissions::from_mode(0o644)).unwrap();
        let refused = read().unwrap_err();
        assert!(refused.contains(path.to_str().unwrap()) && refused.contains("644"), "{refused}");
        fs::set_permissions(path, fs::Permissions::from_mode(0o600)).unwrap();
    }
    for path in [&ca.file, &client.cert, &client.key, &password_file] {
        let content = fs::read(path).unwrap();
        fs::write(path, "two\nlines\n").unwrap();
        let refused = read().unwrap_err();
        assert!(refused.contains(path.to_str().unwrap()) && !refused.contains("two"), "{refused}");
        fs::write(path, content).unwrap();
    }
    read().unwrap();
}

/// A member of etcd that requires all credentials, and the files of an authorized client.
struct Site {
    cluster: Cluster,
    folder: TempDir,
    ca: PathBuf,
    client: ClientCertificate,
    password_file: PathBuf,
}

impl Site {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let ca = Authority::new(folder.path(), "ca");
        let ClientCertificate { cert, key } = ca.certify(folder.path(), "member");
        let cluster = Cluster::start_with(1, Some(Certificates { ca: ca.file.clone(), cert, key }));
        let range = format!("{PREFIX}/");
        for arguments in [
            &["user", "add", "root:secret"][..],
            &["user", "add", &format!("gdp:{PASSWORD}")],
            &["role", "add", "root"],
            &["role", "add", "rib"],
            &["role", "grant-permission", "--prefix=true", "rib", "readwrite", &range],
            &["user", "grant-role", "root", "root"],
            &["user", "grant-role", "gdp", "rib"],
            &["auth", "enable"],
        ] {
            cluster.etcdctl(&[0], arguments);
        }
        let client = ca.certify(folder.path(), "client");
        let password_file = secret(&folder.path().join("password"), &format!("{PASSWORD}\n"));
        Self { cluster, ca: ca.file, client, password_file, folder }
    }

    fn access(&self) -> Access {
        Access {
            tls: Some(Tls { ca: self.ca.clone(), client: Some(self.client.clone()) }),
            login: Some(Login { user: "gdp".into(), password_file: self.password_file.clone() }),
        }
    }

    fn client(&self, access: &Access) -> EtcdClient {
        EtcdClient::new(&self.cluster.endpoints(), access).unwrap()
    }

    /// Returns the error of a replica with this access.
    async fn refused(&self, access: &Access) -> String {
        let place = KeySpace::new(PREFIX);
        let refused = Copy::list(&place, &mut self.client(access)).await.unwrap_err().to_string();
        assert!(refused.contains(&self.cluster.endpoints()[0].to_string()), "{refused}");
        refused
    }
}

/// CA for members and clients.
struct Authority {
    file: PathBuf,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    fn new(folder: &Path, name: &str) -> Self {
        let (key, mut params) = (KeyPair::generate().unwrap(), CertificateParams::default());
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let file = folder.join(format!("{name}.pem"));
        fs::write(&file, params.self_signed(&key).unwrap().pem()).unwrap();
        Self { file, issuer: Issuer::new(params, key) }
    }

    /// Issues a certificate for a member on this machine, or for a client.
    fn certify(&self, folder: &Path, name: &str) -> ClientCertificate {
        let key = KeyPair::generate().unwrap();
        let params = CertificateParams::new(vec!["127.0.0.1".into()]).unwrap();
        let cert = folder.join(format!("{name}.pem"));
        fs::write(&cert, params.signed_by(&key, &self.issuer).unwrap().pem()).unwrap();
        ClientCertificate { cert, key: secret(&folder.join(format!("{name}.key")), &key.serialize_pem()) }
    }
}

fn secret(path: &Path, content: &str) -> PathBuf {
    fs::write(path, content).unwrap();
    fs::set_permissions(path, fs::Permissions::from_mode(0o600)).unwrap();
    path.into()
}
