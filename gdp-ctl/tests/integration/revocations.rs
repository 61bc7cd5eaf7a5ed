//! An owner's revocations remain in effect after the daemon with the RIB restarts, without being
//! sent again.

use std::net::UdpSocket;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::SystemTime;

use crate::owner::Owner;
use crate::switch::{TIMEOUT, config, wait};
use gdp::unstable::{Ended, Node, NodeConfig, NodeError, PublishOptions};
use gdp_core::cert::{AdCert, CertError, Issued, Revocation, issue};
use gdp_core::identity::Identity;
use gdp_core::name::NamePrefix;
use gdp_ctl::client::Client;
use gdp_daemon::config::Config;
use gdp_daemon::serve::{Running, start};
use gdp_proto::admin::Request;
use gdp_proto::control::{EntityRequest, RefusalCode, Response};

#[tokio::test(flavor = "multi_thread")]
async fn a_rib_that_starts_anew_refuses_what_was_revoked() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = config(folder.path(), "s1");
    let switch = start(config.clone()).await.unwrap();
    let at = switch.udp_addr().unwrap();
    config.udp = Some(at);
    let (owner, robot) = (Owner::new("topic", "/chatter"), Identity::generate("proxy").unwrap());
    {
        let node = node(&switch, &robot).await;
        let publisher =
            node.publish(owner.card.proof(), owner.ad_cert(&robot, 1), PublishOptions::reliable()).await.unwrap();
        assert!(matches!(ask(&config, owner.revocation(1, 1)).await, Response::Done));
        let ended = tokio::time::timeout(TIMEOUT, publisher.ended()).await.unwrap();
        assert!(matches!(ended, Ended::Right(CertError::Revoked { serial: 1, .. })), "{ended}");
    }
    let file = folder.path().join("s1.revocations");
    assert_eq!(std::fs::metadata(&file).unwrap().permissions().mode() & 0o7777, 0o600);
    switch.stop().await;
    wait("the address to be free", async || UdpSocket::bind(at).is_ok()).await;

    // Neither the robot nor anyone else sends the revocation again.
    let switch = start(config.clone()).await.unwrap();
    let robot = node(&switch, &robot).await;
    let publish = async |serial| {
        let cert = owner.ad_cert_of(robot.name(), serial);
        robot.publish(owner.card.proof(), cert, PublishOptions::reliable()).await
    };
    let error = publish(1).await.err().unwrap();
    assert!(matches!(&error, NodeError::Refused(refusal) if refusal.code == RefusalCode::Revoked), "{error}");
    let _publisher = publish(2).await.unwrap();
    // An older revocation cannot replace it either.
    assert!(matches!(ask(&config, owner.revocation(2, 3)).await, Response::Done));
    switch.stop().await;
    wait("the address to be free", async || UdpSocket::bind(at).is_ok()).await;
    let switch = start(config.clone()).await.unwrap();
    let refused = tokio::task::spawn_blocking({
        let (config, request) = (config.clone(), owner.revocation(1, 1));
        move || try_ask(&config.socket, request)
    });
    let error = refused.await.unwrap().unwrap_err();
    assert!(error.contains("rolled back: revocation 1"), "{error}");
    // The operator of the switch may list names by a prefix of only one digit.
    let digit: NamePrefix = owner.card.name().to_string()[..1].parse().unwrap();
    wait("the robot to be there again", async || {
        let query = EntityRequest::Query { prefix: digit.clone(), after: None };
        matches!(ask(&config, query).await, Response::Records { records, .. } if records.len() == 1)
    })
    .await;
    switch.stop().await;

    std::fs::write(&file, "damaged").unwrap();
    wait("the address to be free", async || UdpSocket::bind(at).is_ok()).await;
    let error = start(config).await.err().expect("no start without knowing").to_string();
    assert!(error.contains("s1.revocations") && error.contains("remove it"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_kept_is_not_said_to_be_done() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path(), "s1");
    let switch = start(config.clone()).await.unwrap();
    let (owner, file) = (Owner::new("topic", "/chatter"), folder.path().join("s1.revocations"));
    let revoke = async || {
        let (socket, request) = (config.socket.clone(), owner.revocation(1, 1));
        tokio::task::spawn_blocking(move || try_ask(&socket, request)).await.unwrap()
    };
    // A file cannot replace a folder that is not empty.
    std::fs::create_dir_all(file.join("in the way")).unwrap();
    for _ in 0..2 {
        let error = revoke().await.unwrap_err();
        assert!(error.contains("taken in, but not kept") && error.contains("s1.revocations"), "{error}");
    }
    std::fs::remove_dir_all(&file).unwrap();
    assert!(matches!(revoke().await, Ok(Response::Done)), "the same again");
    assert!(file.is_file());
    switch.stop().await;
}

impl Owner {
    fn ad_cert(&self, entity: &Identity, serial: u64) -> Issued<AdCert> {
        self.ad_cert_of(entity.name(), serial)
    }

    fn ad_cert_of(&self, entity: gdp_wire::Name, serial: u64) -> Issued<AdCert> {
        let (name, scope, not_before) = (self.card.name(), Vec::new(), 0);
        let not_after = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs() + 3600;
        let claims = AdCert { name, entity, scope, serial, not_before, not_after };
        issue(&self.key, &claims).unwrap().into()
    }

    /// Returns a revocation with this number that revokes one certificate.
    fn revocation(&self, number: u64, serial: u64) -> EntityRequest {
        let mut revoked = vec![1, serial];
        revoked.dedup();
        let claims = Revocation { name: self.card.name(), number, floor: 0, revoked, signer: None };
        EntityRequest::Revoke { proof: self.card.proof(), revocation: issue(&self.key, &claims).unwrap() }
    }
}

async fn node(switch: &Running, identity: &Identity) -> Node {
    let link = format!("udp://{}", switch.udp_addr().unwrap()).parse().unwrap();
    Node::connect(NodeConfig::new(identity.clone(), link)).await.unwrap()
}

/// Sends a request as the user who runs the daemon.
async fn ask(config: &Config, request: EntityRequest) -> Response {
    let socket = config.socket.clone();
    tokio::task::spawn_blocking(move || try_ask(&socket, request)).await.unwrap().unwrap()
}

fn try_ask(socket: &Path, request: EntityRequest) -> Result<Response, String> {
    let mut client = Client::connect(socket).map_err(|error| error.to_string())?;
    let request = Request::Entity { entity: None, request: request.into() };
    client.ask(&request).map_err(|error| error.to_string())
}
