//! Control messages: `docs/vectors/control.json` has each kind of request and response, and
//! messages that are refused. `GDP_WRITE_VECTORS=1 cargo test -p gdp-proto --test schema` writes
//! the file anew. The same bytes are validated against `docs/gdp.cddl`.

#[path = "../../gdp-core/tests/examples/mod.rs"]
mod examples;
mod messages;
#[path = "../../gdp-core/tests/unit/published_schema.rs"]
mod schema;
#[path = "../../gdp-core/tests/unit/published_vectors.rs"]
mod vectors;

use std::collections::BTreeSet;

use examples::Parties;
use gdp_core::cbor::Value;
use gdp_proto::control::{self, Request, Response};
use messages::{Kinds, requests, responses};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value as Json, json};

#[test]
fn vectors_of_control_messages() {
    let parties = Parties::new();
    let mut seen = BTreeSet::new();
    let requests: Vec<Json> =
        requests(&parties).iter().map(|request| message("request", request, request.kinds(), &mut seen)).collect();
    let responses: Vec<Json> =
        responses(&parties).iter().map(|response| message("response", response, response.kinds(), &mut seen)).collect();
    let missing: Vec<_> = messages::all_kinds().into_iter().filter(|kind| !seen.contains(kind)).collect();
    assert!(missing.is_empty(), "no example of {missing:?}");
    let computed = json!({
        "about": "requests and responses with their length, as on a stream; kinds: the variants in it, outermost first. \
            Certificates are those of kinds.json. Any valid CBOR of the same value is accepted.",
        "requests": requests,
        "responses": responses,
        "refused": refused(),
    });
    vectors::check("control.json", &computed);
}

/// A schema that admits everything would pass the other test too.
#[test]
fn the_schema_refuses_other_messages() {
    let text = |text: &str| Value::Text(text.into());
    let map =
        |fields: &[(&str, Value)]| Value::Map(fields.iter().map(|(name, value)| (text(name), value.clone())).collect());
    let detach = |switch: Value| map(&[("Detach", map(&[("switch", switch), ("entity", name())]))]);
    let encode = |value: &Value| gdp_core::cbor::encode(value).unwrap();
    schema::check("request", &encode(&detach(name()))).unwrap();
    for (rule, value) in [
        ("request", text("Later")),
        ("request", map(&[("Teleport", map(&[]))])),
        ("request", detach(text("a name"))),
        ("request", detach(Value::Bytes(vec![0; 33]))),
        ("request", map(&[("Detach", map(&[("switch", name())]))])),
        ("response", text("Ready")),
        ("response", map(&[("Refused", map(&[("code", text("Tired")), ("reason", text(""))]))])),
        ("response", map(&[("Reported", map(&[("run", (-1).into())]))])),
    ] {
        assert!(schema::check(rule, &encode(&value)).is_err(), "{rule} {value:?}");
    }
}

fn message<T: Serialize + DeserializeOwned>(
    rule: &str,
    value: &T,
    kinds: Vec<&'static str>,
    seen: &mut BTreeSet<&'static str>,
) -> Json {
    let bytes = control::encode(value).unwrap();
    schema::check(rule, &bytes[4..]).unwrap_or_else(|error| panic!("{kinds:?}: {error}"));
    let decoded: T = control::decode(&bytes[4..]).unwrap();
    assert_eq!(control::encode(&decoded).unwrap(), bytes, "{kinds:?}");
    seen.extend(kinds.iter().copied());
    json!({ "kinds": kinds, "bytes": hex::encode(bytes) })
}

/// Requests that are refused, with the code and the reason of this implementation.
fn refused() -> Vec<Json> {
    let text = |text: &str| Value::Text(text.into());
    let map =
        |fields: &[(&str, Value)]| Value::Map(fields.iter().map(|(name, value)| (text(name), value.clone())).collect());
    let encode = |value: &Value| gdp_core::cbor::encode(value).unwrap();
    let detach = map(&[("Detach", map(&[("switch", name()), ("entity", name())]))]);
    let mut nested = text("Ready");
    for _ in 0..24 {
        nested = map(&[("Onward", map(&[("to", name()), ("hops", 1.into()), ("request", nested)]))]);
    }
    let proof = map(&[("owner_key", Value::Bytes(vec![2; 33])), ("digest", name()), ("later", 1.into())]);
    let report =
        map(&[("switch", proof), ("attached", Value::Array(vec![])), ("own_bit", Value::Null), ("shown", Value::Null)]);
    let field = [&[0x66][..], b"switch", &[0x58, 32], &[7; 32]].concat();
    let twice = [&[0xa1, 0x66][..], b"Detach", &[0xa2], &field, &field].concat();
    let cases = [
        ("no CBOR", vec![0xff]),
        ("nothing", vec![]),
        ("a byte behind the message", [encode(&detach), vec![0]].concat()),
        ("a message that is cut off", encode(&detach)[..20].to_vec()),
        ("a kind of a later release", encode(&map(&[("Teleport", map(&[("to", 7.into())]))]))),
        ("a kind of an entity's request of a later release", encode(&map(&[("Entity", map(&[("Fly", map(&[]))]))]))),
        ("a field is missing", encode(&map(&[("Detach", map(&[("switch", name())]))]))),
        ("a field occurs twice", twice),
        (
            "a name of 31 bytes",
            encode(&map(&[("Detach", map(&[("switch", Value::Bytes(vec![0; 31])), ("entity", name())]))])),
        ),
        ("a further field of a name proof", encode(&map(&[("Report", report)]))),
        ("nested more than 24 deep", encode(&nested)),
        ("65537 bytes", vec![0; 65537]),
    ];
    let cases = cases.map(|(description, bytes)| {
        let error = control::decode::<Request>(&bytes).expect_err(description);
        json!({
            "description": description,
            "length": bytes.len(),
            "bytes": if bytes.len() > 4096 { "zeros".into() } else { hex::encode(&bytes) },
            "code": error.code(),
            "refused": error.to_string(),
        })
    });
    let further = map(&[("Detach", map(&[("switch", name()), ("entity", name()), ("later", 1.into())]))]);
    control::decode::<Request>(&encode(&further)).expect("further fields of a request are skipped");
    let unknown = map(&[("Refused", map(&[("code", text("Tired")), ("reason", text(""))]))]);
    control::decode::<Response>(&encode(&unknown)).expect_err("an unknown code is no answer");
    cases.into()
}

fn name() -> Value {
    Value::Bytes(vec![7; 32])
}
