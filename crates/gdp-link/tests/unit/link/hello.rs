//! The bytes of a hello.

#[path = "../../../../gdp-core/tests/unit/published_schema.rs"]
mod schema;

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
