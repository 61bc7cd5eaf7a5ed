//! Unit tests of the HTTP proxy's replies.

use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};

use super::*;

const TO: &str = "switch.example:443";

#[tokio::test]
async fn a_proxy_that_agrees_leads_to_the_switch() {
    let (connected, request) = ask("HTTP/1.1 200 Connection established\r\nVia: test\r\n\r\n").await;
    let (mut stream, mut far) = connected.unwrap();
    assert!(request.starts_with("CONNECT switch.example:443 HTTP/1.1\r\n"), "{request}");
    assert!(request.contains("proxy-authorization: Basic dXNlcjpwQHNz\r\n"), "{request}");
    stream.write_all(b"hello").await.unwrap();
    let mut bytes = [0; 5];
    far.read_exact(&mut bytes).await.unwrap();
    assert_eq!(&bytes, b"hello");
}

#[tokio::test]
async fn a_proxy_that_refuses_says_what_to_do() {
    for (answer, expected) in [
        ("HTTP/1.1 403 Forbidden\r\nContent-Length: 2\r\n\r\nno", "403 Forbidden"),
        ("HTTP/1.1 407 Proxy Authentication Required\r\nContent-Length: 0\r\n\r\n", "USER:PASSWORD"),
        ("HTTP/1.1 200 OK\r\n\r\nearly", "before the connection is used"),
        ("SSH-2.0-OpenSSH\r\n\r\n", "does not speak HTTP"),
        ("", "does not speak HTTP"),
    ] {
        let error = ask(answer).await.0.map(drop).unwrap_err().to_string();
        assert!(error.contains(expected), "{answer:?}: {error}");
    }
    let endless = format!("HTTP/1.1 200 OK\r\nA: {}\r\n\r\n", "a".repeat(2 * MAX_ANSWER));
    assert!(ask(&endless).await.0.is_err());
}

#[test]
fn the_environment_names_the_proxy_and_its_exceptions() {
    let of = |https: &str, no: &str| HttpProxy::of(&Matcher::builder().https(https).no(no).build(), TO);
    let found = of("http://user:p%40ss@proxy.example:3128", "").unwrap().unwrap();
    assert_eq!(found.to_string(), "http://proxy.example:3128", "without the password");
    assert!(found.authorization.is_some());
    assert_eq!(of("http://[2001:db8::1]:3128", "").unwrap().unwrap().to_string(), "http://[2001:db8::1]:3128");
    assert!(of("http://proxy.example:3128", "example").unwrap().is_none());
    assert!(of("", "").unwrap().is_none());
    assert!(matches!(of("socks5://proxy.example:1080", ""), Err(HttpProxyError::Scheme)));
    assert!(matches!(HttpProxy::of(&Matcher::builder().build(), "a b:443"), Err(HttpProxyError::Address(_))));
}

/// Asks a proxy that sends this answer and closes if the connection is refused. Returns both ends,
/// and the request.
async fn ask(answer: &str) -> (Result<(DuplexStream, DuplexStream), HttpProxyError>, String) {
    let matcher = Matcher::builder().https("http://user:p%40ss@proxy.example:3128").build();
    let proxy = HttpProxy::of(&matcher, TO).unwrap().unwrap();
    let (near, mut far) = duplex(64 << 10);
    let answered = async {
        let mut request = vec![0; 4096];
        let mut length = 0;
        while !request[..length].ends_with(b"\r\n\r\n") {
            length += far.read(&mut request[length..]).await.unwrap();
        }
        far.write_all(answer.as_bytes()).await.unwrap();
        if answer.is_empty() {
            far.shutdown().await.unwrap();
        }
        request.truncate(length);
        (far, String::from_utf8(request).unwrap())
    };
    let (stream, (far, request)) = tokio::join!(proxy.connect(near, TO), answered);
    (stream.map(|stream| (stream, far)), request)
}
