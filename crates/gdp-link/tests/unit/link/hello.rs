//! The bytes of a hello.

#[path = "../../../../gdp-core/tests/unit/published_schema.rs"]
mod schema;

use serde_json::json;

use super::*;
use gdp_core::cert::{MemberCert, Membership};

#[test]
fn hellos_have_the_published_schema() {
    let valid = |hello: &Hello| schema::check("hello", &control::encode(hello).unwrap()[4..]);
    valid(&switch()).unwrap();
    valid(&endpoint()).unwrap();
    for bad in [
        Hello { link_id: 0, ..switch() },
        Hello { lane: 4, ..endpoint() },
        Hello { mtu: MIN_MTU - 1, ..switch() },
        Hello { mtu: MAX_MTU + 1, ..switch() },
    ] {
        valid(&bad).unwrap_err();
    }
}

#[test]
fn vectors_of_hellos() {
    let bytes = |hello: &Hello| control::encode(hello).unwrap();
    let good = |description, hello: Hello| {
        let read: Hello = control::decode(&bytes(&hello)[4..]).unwrap();
        read.check().unwrap();
        json!({ "description": description, "bytes": hex::encode(bytes(&hello)) })
    };
    let endpoint = || Hello { credentials: None, ..endpoint() };
    let cut = |hello: &Hello| bytes(hello)[4..bytes(hello).len() - 1].to_vec();
    let hellos = vec![
        good("a switch", switch()),
        good("an endpoint on its last lane, on the switch's host", endpoint()),
        good("a release that knows no echoes while QUIC is alive", Hello { echo_ms: None, ..switch() }),
    ];
    let bad = |hello: Hello| bytes(&hello)[4..].to_vec();
    let refused = [
        ("link id 0", bad(Hello { link_id: 0, ..switch() })),
        ("a lane that does not exist", bad(Hello { lane: 4, ..endpoint() })),
        ("a lane of a switch", bad(Hello { lane: 1, ..switch() })),
        ("an MTU that is too small", bad(Hello { mtu: MIN_MTU - 1, ..endpoint() })),
        ("an MTU that is too large", bad(Hello { mtu: MAX_MTU + 1, ..endpoint() })),
        ("a hello that ends too early", cut(&switch())),
    ];
    let refused = refused.map(|(description, body)| {
        let read = control::decode::<Hello>(&body).map_err(LinkError::from).and_then(|hello| hello.check());
        json!({ "description": description, "body": hex::encode(&body), "refused": read.unwrap_err().to_string() })
    });
    let about = "hellos with their length, as on the stream; those that are refused without it. A side that is sent \
                 one of these closes the link with code 2. Any valid CBOR of the same value is accepted";
    crate::vectors::check("hello.json", &json!({ "about": about, "hellos": hellos, "refused": refused }));
}

fn switch() -> Hello {
    Hello {
        role: Role::Switch,
        digest: [7; 32],
        link_id: u32::MAX,
        lane: 0,
        mtu: MAX_MTU,
        zero_checksum: true,
        host: None,
        frames_at: Some([169, 254, 1, 2]),
        run: None,
        echo_ms: Some(40),
        credentials: None,
    }
}

fn endpoint() -> Hello {
    let domain = Identity::generate("domain").unwrap();
    let (entity, role) = (Name::from_bytes([1; 32]), "viewer".into());
    let claims = MemberCert { domain: domain.name(), entity, role, serial: 1, not_before: 0, not_after: 1 };
    let credentials = Credentials { membership: Membership::issue(&domain, &claims).unwrap(), peers: vec![] };
    Hello {
        role: Role::Endpoint,
        link_id: 1,
        lane: 3,
        mtu: MIN_MTU,
        host: Some(u64::MAX),
        frames_at: None,
        run: Some(1_800_000_000_000_000_000),
        credentials: Some(credentials),
        ..switch()
    }
}
