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
        Admission::Redirect(_) => 303,
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
    let keep = |access: &Access, secret: &str| match access.admit(&request(&format!("/?a=b&token={secret}"), &[host])) {
        Admission::Redirect(Some(cookie)) => cookie,
        other => panic!("no cookie: {other:?}"),
    };
    let kept = keep(&access, SECRET);
    let pair = kept.strip_suffix("; Path=/; HttpOnly; SameSite=Strict").unwrap();
    assert!(pair.starts_with("gdp_") && !pair.contains(SECRET), "{pair}");
    let cookie = format!("other=1; {pair}");
    assert_eq!(status(access.admit(&request("/", &[host, ("cookie", &cookie)]))), 200);
    let (name, value) = pair.split_once('=').unwrap();
    for wrong in [format!("{name}=no"), format!("{name}={SECRET}"), format!("gdp={value}"), format!("gdp={SECRET}")] {
        assert_eq!(status(access.admit(&request("/", &[host, ("cookie", &wrong)]))), 401, "{wrong}");
    }
    assert_eq!(status(access.admit(&request(&format!("/?token={value}"), &[host]))), 401, "it is no token");
    // A second server of this host has another cookie, so a browser keeps both.
    let other = "f".repeat(32);
    let elsewhere = keep(&Access::token_or_cookie(AccessToken::parse(&other).unwrap(), "gdp"), &other);
    assert_ne!(elsewhere.split_once('=').unwrap().0, name);
    // The token leaves the address also if the cookie is there, and so does one that is not valid.
    for (query, keeps) in [(format!("/?token={SECRET}"), true), ("/?token=former".to_owned(), false)] {
        let admission = access.admit(&request(&query, &[host, ("cookie", &cookie)]));
        assert!(matches!(&admission, Admission::Redirect(kept) if kept.is_some() == keeps), "{admission:?}");
    }
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
    for mark in [';', '+', '%', '&', '#', '=', '"', '\\', '/', 'ä', ' '] {
        assert!(read(&format!("{SECRET}{mark}{SECRET}"), 0o600).unwrap_err().contains("tildes"), "{mark}");
    }
    assert!(read(&format!("._~-AZaz09{SECRET}"), 0o600).is_ok());
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
