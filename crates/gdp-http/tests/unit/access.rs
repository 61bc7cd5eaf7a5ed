//! Who is let in: by host, token and cookie.

use std::fs::{Permissions, set_permissions, write};

use super::*;

const SECRET: &str = "0123456789abcdef0123456789abcdef";

fn token() -> AccessToken {
    AccessToken::parse(SECRET).unwrap()
}

fn request(target: &str, headers: &[(&str, &str)]) -> Request<()> {
    let mut request = Request::builder().uri(target);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    request.body(()).unwrap()
}

fn status(admission: Admission) -> u16 {
    match admission {
        Admission::Granted => 200,
        Admission::Refused(status, _) => status.as_u16(),
        Admission::Keep(_) => 303,
    }
}

#[test]
fn without_a_token_only_names_of_this_machine_are_served() {
    let access = Access::open_on_loopback();
    for host in ["127.0.0.1", "127.0.0.1:9404", "localhost:1", "LOCALHOST", "[::1]:9404", "192.0.2.1:80"] {
        assert_eq!(status(access.admit(&request("/", &[("host", host)]))), 200, "{host}");
    }
    for host in ["evil.example", "127.0.0.1.evil.example:9404", "localhost.", "::1", "[::1", "127.0.0.1:x", ""] {
        assert_eq!(status(access.admit(&request("/", &[("host", host)]))), 421, "{host}");
    }
    assert_eq!(status(access.admit(&request("/", &[]))), 421);
    assert_eq!(status(access.admit(&request("/", &[("host", "localhost"), ("host", "localhost")]))), 421);
    assert_eq!(status(access.admit(&request("http://evil.example/", &[("host", "localhost")]))), 421);
}

#[test]
fn a_bearer_token_is_compared_whole() {
    let access = Access::token(token());
    let with = |value: &str| status(access.admit(&request("/", &[("host", "localhost"), ("authorization", value)])));
    assert_eq!(with(&format!("Bearer {SECRET}")), 200);
    assert_eq!(with(&format!("bearer  {SECRET} ")), 200);
    assert_eq!(with(&format!("Bearer {}", &SECRET[1..])), 401);
    assert_eq!(with(&format!("Bearer {SECRET}0")), 401);
    assert_eq!(with(&format!("Basic {SECRET}")), 401);
    assert_eq!(with("Bearer "), 401);
    assert_eq!(with(""), 401);
    // Neither cookie nor query replaces it here.
    let query = format!("/?token={SECRET}");
    assert_eq!(status(access.admit(&request(&query, &[("host", "localhost")]))), 401);
    // Who knows the token may use any name of the machine.
    let named = [("host", "robot7.example"), ("authorization", &*format!("Bearer {SECRET}"))];
    assert_eq!(status(access.admit(&request("/", &named))), 200);
}

#[test]
fn a_browser_keeps_the_token_as_a_cookie() {
    let access = Access::token_or_cookie(token(), "gdp");
    let host = ("host", "127.0.0.1:8315");
    let Admission::Keep(cookie) = access.admit(&request(&format!("/?a=b&token={SECRET}"), &[host])) else {
        panic!("no cookie")
    };
    assert_eq!(cookie, format!("gdp={SECRET}; Path=/; HttpOnly; SameSite=Strict"));
    let cookie = format!("other=1; gdp={SECRET}");
    assert_eq!(status(access.admit(&request("/", &[host, ("cookie", &cookie)]))), 200);
    assert_eq!(status(access.admit(&request("/", &[host, ("cookie", "gdp=no")]))), 401);
    assert_eq!(status(access.admit(&request("/?token=no", &[host]))), 401);
    let elsewhere = [("host", "evil.example"), ("cookie", &*cookie)];
    assert_eq!(status(access.admit(&request("/", &elsewhere))), 421);
}

#[test]
fn a_token_file_is_private_and_has_a_token() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("token");
    let read = |content: &str, mode| {
        write(&path, content).unwrap();
        set_permissions(&path, Permissions::from_mode(mode)).unwrap();
        AccessToken::from_file(&path).map_err(|error| error.to_string())
    };
    assert_eq!(read(&format!("{SECRET}\n"), 0o640).unwrap().secret(), SECRET);
    assert!(read(SECRET, 0o644).unwrap_err().contains("chmod o="));
    assert!(read("short", 0o600).unwrap_err().contains("openssl rand -hex 32"));
    assert!(read(&"x".repeat(300), 0o600).is_err());
    assert!(
        AccessToken::from_file(folder.path().join("none").as_path()).unwrap_err().to_string().contains("cannot read")
    );
}

#[test]
fn random_tokens_differ_and_are_not_shown() {
    let (one, other) = (AccessToken::random().unwrap(), AccessToken::random().unwrap());
    assert_eq!(one.secret().len(), 64);
    assert_ne!(one.secret(), other.secret());
    assert_eq!(format!("{one:?}"), "AccessToken(…)");
}
