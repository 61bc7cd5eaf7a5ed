//! Peers of other releases: an older one, the next one, and one that is two versions ahead.

use std::net::SocketAddr;
use std::time::Duration;

use quinn::{ConnectionError, Endpoint};

use super::*;
use crate::link::LinkError;
use crate::link::liveness::Pace;
use crate::link::{HelloConfig, Link, LinkIds, LinkLocation, QuicConfigs, QuicMtu, RekeySchedule, SERVER_NAME};
use crate::link::{greet_as_client, greet_as_server};
use crate::port::CurrentPair;
use gdp_core::identity::Identity;
use gdp_core::peer::Role;
use quinn::Connection;
use quinn::crypto::rustls::HandshakeData;

const FIRST: Versions = Versions { oldest: 1, newest: 1 };
const NEXT: Versions = Versions { oldest: 2, newest: 3 };
const AFTER_NEXT: Versions = Versions { oldest: 3, newest: 4 };

#[tokio::test]
async fn releases_next_to_each_other_take_the_newest_version_in_common() {
    for (client, server, version) in [
        (Versions::SPOKEN, Versions::SPOKEN, 2),
        (NEXT, Versions::SPOKEN, 2),
        (Versions::SPOKEN, NEXT, 2),
        (NEXT, NEXT, 3),
        (NEXT, AFTER_NEXT, 3),
        (AFTER_NEXT, NEXT, 3),
    ] {
        let (client, server) = meet(client, server).await;
        assert_eq!(client.protocol, format!("gdp/{version}"));
        let (client, server) = (client.link.unwrap(), server.link.unwrap());
        assert_eq!((client.peer().role, server.peer().role), (Role::Switch, Role::Endpoint));
        // These releases state no interval of echoes.
        assert_eq!((client.negotiated_pace(), client.pace()), (None, Pace::UDP));
    }
}

/// Both sides learn which versions there are, and which side is to be upgraded.
#[tokio::test]
async fn a_version_that_is_not_spoken_any_more_is_refused_by_name_on_both_sides() {
    for (old, new) in [(FIRST, Versions::SPOKEN), (Versions::SPOKEN, AFTER_NEXT), (FIRST, AFTER_NEXT)] {
        let expected = [old.newest, new.oldest, new.newest].map(|version| format!("gdp/{version}"));
        for new_dials in [false, true] {
            let (old_side, new_side) = if new_dials {
                let (client, server) = meet(new, old).await;
                (server, client)
            } else {
                meet(old, new).await
            };
            let refused = new_side.link.unwrap_err();
            assert!(matches!(refused, LinkError::OldVersion { .. }), "{refused}");
            let [refused, told] = [refused.to_string(), old_side.closed];
            for version in &expected {
                assert!(refused.contains(version) && told.contains(version), "{refused}; {told}");
            }
            assert!(refused.contains("upgrade the peer") && told.contains("upgrade this side"), "{refused}; {told}");
        }
    }
}

/// One side of a meeting.
struct Side {
    link: Result<Link, LinkError>,
    protocol: String,
    /// The end of the connection, as its other side caused it.
    closed: String,
}

/// Two nodes that speak these versions make a link.
async fn meet(client: Versions, server: Versions) -> (Side, Side) {
    let listener = endpoint(server);
    let address = listener.local_addr().unwrap();
    let dialler = endpoint(client);
    let dial = async {
        let connection = dialler.connect(address, SERVER_NAME).unwrap().await.unwrap();
        let config = config(client, Role::Endpoint);
        side(connection.clone(), greet_as_client(connection, LOCATION, &config, None).await).await
    };
    let listen = async {
        let connection = listener.accept().await.unwrap().await.unwrap();
        let config = config(server, Role::Switch);
        side(connection.clone(), greet_as_server(connection, LOCATION, &config).await).await
    };
    tokio::time::timeout(Duration::from_secs(20), async { tokio::join!(dial, listen) }).await.expect("a meeting")
}

async fn side(connection: Connection, link: Result<Link, LinkError>) -> Side {
    let handshake = connection.handshake_data().unwrap().downcast::<HandshakeData>().unwrap();
    let protocol = String::from_utf8(handshake.protocol.unwrap()).unwrap();
    let closed = match &link {
        Ok(_) => String::new(),
        Err(_) => match connection.closed().await {
            ConnectionError::ApplicationClosed(close) => String::from_utf8(close.reason.to_vec()).unwrap(),
            other => other.to_string(),
        },
    };
    Side { link, protocol, closed }
}

const LOOPBACK: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 0);
const LOCATION: LinkLocation = LinkLocation::Udp { bound: LOOPBACK, pair: None };
const MTU: QuicMtu = QuicMtu { initial: 1200, discover_up_to: None };

fn endpoint(versions: Versions) -> Endpoint {
    let configs = QuicConfigs::new(identity().key(), versions, true).unwrap();
    let mut endpoint = Endpoint::server(configs.server(MTU), LOOPBACK).unwrap();
    endpoint.set_default_client_config(configs.client(MTU));
    endpoint
}

fn config(versions: Versions, role: Role) -> HelloConfig {
    HelloConfig {
        identity: identity(),
        role,
        lane: 0,
        link_ids: LinkIds::new(),
        mtu: 1500,
        zero_checksum: false,
        host: None,
        pair: CurrentPair::default(),
        run: None,
        echo_interval: None,
        credentials: Default::default(),
        versions,
        rekey: RekeySchedule::default(),
    }
}

fn identity() -> Identity {
    Identity::generate("switch").unwrap()
}
