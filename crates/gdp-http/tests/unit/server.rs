//! The listener against clients that behave, and clients that do not, over real sockets.

use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::*;
use crate::AccessToken;

const SECRET: &str = "0123456789abcdef0123456789abcdef";

async fn start(access: Access) -> SocketAddr {
    let listener = Listener::bind("127.0.0.1:0".parse().unwrap(), access).unwrap();
    let address = listener.address();
    tokio::spawn(serve(listener, async |request: HttpRequest| match request.path.as_str() {
        "/" => HttpResponse::ok("text/plain", request.parameter("word").unwrap_or_default().into_owned()),
        _ => HttpResponse::not_found(),
    }));
    address
}

/// Sends bytes, and returns everything that comes back.
async fn exchange(address: SocketAddr, bytes: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).await.unwrap();
    // A server that has seen enough may close before it has everything.
    _ = stream.write_all(bytes).await;
    let mut answer = Vec::new();
    _ = timeout(Duration::from_secs(10), stream.read_to_end(&mut answer)).await.expect("the connection stays open");
    String::from_utf8(answer).unwrap()
}

fn get(target: &str, more: &str) -> Vec<u8> {
    format!("GET {target} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n{more}\r\n").into_bytes()
}

#[tokio::test]
async fn it_answers_get_and_nothing_else() {
    let address = start(Access::open_on_loopback()).await;
    let answer = exchange(address, &get("/?word=a%20b", "")).await;
    assert!(answer.starts_with("HTTP/1.1 200 ") && answer.ends_with("\r\n\r\na b"), "{answer}");
    for header in ["cache-control: no-store", "nosniff", "content-security-policy: default-src 'none'"] {
        assert!(answer.contains(header), "{header}: {answer}");
    }
    assert!(!answer.contains("access-control"), "{answer}");
    assert!(exchange(address, &get("/other", "")).await.starts_with("HTTP/1.1 404 "));
    let post = b"POST / HTTP/1.1\r\nhost: localhost\r\ncontent-length: 99999999\r\n\r\nx";
    assert!(exchange(address, post).await.starts_with("HTTP/1.1 405 "));
    let rebound = b"GET / HTTP/1.1\r\nhost: evil.example\r\n\r\n";
    assert!(exchange(address, rebound).await.starts_with("HTTP/1.1 421 "));
}

#[tokio::test]
async fn a_token_opens_it() {
    let address = start(Access::token(AccessToken::parse(SECRET).unwrap())).await;
    let refused = exchange(address, &get("/", "")).await;
    assert!(refused.starts_with("HTTP/1.1 401 ") && refused.contains("www-authenticate: Bearer"), "{refused}");
    let wrong = format!("authorization: Bearer {}\r\n", SECRET.replace('0', "1"));
    assert!(exchange(address, &get("/", &wrong)).await.starts_with("HTTP/1.1 401 "));
    let right = format!("authorization: Bearer {SECRET}\r\n");
    assert!(exchange(address, &get("/", &right)).await.starts_with("HTTP/1.1 200 "));
}

#[tokio::test]
async fn a_browser_is_led_to_the_path_alone() {
    let address = start(Access::token_or_cookie(AccessToken::parse(SECRET).unwrap(), "gdp")).await;
    let answer = exchange(address, &get(&format!("//evil.example/x?token={SECRET}"), "")).await;
    assert!(answer.starts_with("HTTP/1.1 303 ") && answer.contains("location: /evil.example/x\r\n"), "{answer}");
    let (_, kept) = answer.split_once("set-cookie: ").unwrap();
    let (pair, _) = kept.split_once(';').unwrap();
    assert!(!answer.contains(SECRET), "{answer}");
    let cookie = format!("cookie: {pair}\r\n");
    assert!(exchange(address, &get("/", &cookie)).await.starts_with("HTTP/1.1 200 "));
}

#[tokio::test]
async fn other_machines_need_a_token() {
    let everywhere: SocketAddr = "0.0.0.0:0".parse().unwrap();
    let refused = Listener::bind(everywhere, Access::open_on_loopback()).map(drop).unwrap_err();
    assert!(matches!(refused, HttpError::NotLoopback { .. }), "{refused}");
    Listener::bind(everywhere, Access::token(AccessToken::parse(SECRET).unwrap())).map(drop).unwrap();
    let taken = start(Access::open_on_loopback()).await;
    let refused = Listener::bind(taken, Access::open_on_loopback()).map(drop).unwrap_err();
    assert!(matches!(refused, HttpError::Bind { .. }), "{refused}");
}

#[tokio::test]
async fn giant_headers_and_garbage_end_the_connection() {
    let address = start(Access::open_on_loopback()).await;
    let giant = exchange(address, &get("/", &format!("x: {}\r\n", "x".repeat(4 * MAX_HEADER)))).await;
    assert!(!giant.contains(" 200 "), "{giant}");
    let fields: String = (0..2 * MAX_FIELDS).map(|field| format!("x{field}: 1\r\n")).collect();
    assert!(!exchange(address, &get("/", &fields)).await.contains(" 200 "));
    assert!(!exchange(address, &[0xff; 40_000]).await.contains(" 200 "));
    assert!(exchange(address, &get("/", "")).await.contains(" 200 "));
}

#[tokio::test]
async fn clients_that_only_wait_do_not_keep_others_out() {
    let address = start(Access::open_on_loopback()).await;
    let mut waiting = Vec::new();
    for _ in 0..200 {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.write_all(b"GET / HT").await.unwrap();
        waiting.push(stream);
    }
    assert!(exchange(address, &get("/", "")).await.contains(" 200 "));
    // All but the newest are closed.
    let mut closed = 0;
    for mut stream in waiting {
        let ended = timeout(Duration::from_millis(20), stream.read(&mut [0])).await;
        closed += usize::from(!matches!(ended, Err(_) | Ok(Ok(1..))));
    }
    assert!(closed >= 200 - MAX_CONNECTIONS, "{closed} were closed");
}

#[tokio::test]
async fn clients_without_the_token_do_not_end_connections_of_those_with_it() {
    let address = start(Access::token(AccessToken::parse(SECRET).unwrap())).await;
    let mut member = TcpStream::connect(address).await.unwrap();
    let request = format!("GET /?word=here HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer {SECRET}\r\n\r\n");
    let mut ask = async || {
        member.write_all(request.as_bytes()).await.unwrap();
        let mut answer = Vec::new();
        while !answer.ends_with(b"here") {
            let mut bytes = [0; 1024];
            let read = timeout(Duration::from_secs(10), member.read(&mut bytes)).await.unwrap();
            let read = read.expect("the connection is still open");
            assert!(read > 0, "the connection is still open: {}", String::from_utf8_lossy(&answer));
            answer.extend_from_slice(&bytes[..read]);
        }
    };
    ask().await;
    let mut strangers = Vec::new();
    for _ in 0..4 * MAX_CONNECTIONS {
        let mut stream = TcpStream::connect(address).await.unwrap();
        stream.write_all(b"GET / HT").await.unwrap();
        strangers.push(stream);
    }
    // The last of them has been accepted when a further one is answered.
    assert!(exchange(address, &get("/", "")).await.starts_with("HTTP/1.1 401 "));
    ask().await;
}

#[tokio::test]
async fn a_client_that_sends_too_slowly_is_cut_off() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let mut stream = TcpStream::connect(listener.local_addr().unwrap()).await.unwrap();
    let (accepted, _) = listener.accept().await.unwrap();
    let shared = Arc::new((Access::open_on_loopback(), async |_: HttpRequest| HttpResponse::not_found()));
    let served = tokio::spawn(connection(accepted, Duration::from_millis(300), Arc::default(), shared));
    for byte in b"GET / HTTP/1.1\r\nx" {
        stream.write_all(&[*byte]).await.unwrap();
        sleep(Duration::from_millis(5)).await;
    }
    timeout(Duration::from_secs(10), served).await.expect("it was not cut off").unwrap();
}
