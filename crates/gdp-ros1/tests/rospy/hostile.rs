//! Peers that mean no good, or are broken. After each, the node does its work as before.

use std::time::Duration;

use bytes::Bytes;
use gdp_ros1::xmlrpc::{Call, Value, decode_call, decode_response, encode_call, encode_response};
use gdp_ros1::{Header, Node, PublishOptions, QueueLimits, SourceState, SubscribeOptions, Subscription};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;

use crate::harness::{LIMIT, Master, next_text, registered, string, string_type, until};

#[tokio::test]
async fn whoever_connects_with_nonsense_is_turned_away() {
    let master = Master::start().await;
    let node = master.node("/bridge").await;
    let publisher = node.publish("/chatter", string_type(), PublishOptions::default()).unwrap();
    let port = tcpros_port(&node, "/chatter").await;

    for (what, bytes) in [
        ("a header of 4 GiB", b"\xff\xff\xff\xff".to_vec()),
        ("a field longer than the header", b"\x08\0\0\0\xff\xff\xff\x7fa=b!".to_vec()),
        ("a field without a value", b"\x09\0\0\0\x05\0\0\0topic".to_vec()),
        ("a web browser", b"GET / HTTP/1.1\r\nHost: robot\r\n\r\n".to_vec()),
        ("a header that never ends", [&(1_u32 << 20).to_le_bytes()[..], &vec![0xff; 1 << 20]].concat()),
    ] {
        let mut stream = TcpStream::connect(("localhost", port)).await.unwrap();
        // It may be closed before all is written.
        _ = stream.write_all(&bytes).await;
        let mut answer = Vec::new();
        let ended = timeout(LIMIT, stream.read_to_end(&mut answer)).await;
        assert!(ended.is_ok() && answer.is_empty(), "{what}: {answer:?}");
    }
    for (fields, reason) in [
        (&[("callerid", "/x"), ("md5sum", "*"), ("topic", "/other"), ("type", "*")][..], "does not publish /other"),
        (&[("callerid", "/x"), ("md5sum", "*"), ("service", "/other")], "does not serve /other"),
        (&[("callerid", "/x"), ("md5sum", "00"), ("topic", "/chatter"), ("type", "a/B")], "md5sum"),
        (&[("callerid", "/x"), ("topic", "/chatter")], "md5sum"),
        (&[("md5sum", "*"), ("topic", "/chatter")], "callerid"),
        (&[], "'topic' or 'service'"),
    ] {
        let mut stream = TcpStream::connect(("localhost", port)).await.unwrap();
        stream.write_all(&Header::new(fields.iter().copied()).encode()).await.unwrap();
        let header = read_header(&mut stream).await;
        let error = header.get("error").unwrap();
        assert!(error.contains(reason), "{error}");
    }
    // Those who say nothing at all keep nobody out.
    let mut silent = Vec::new();
    for _ in 0..200 {
        silent.push(TcpStream::connect(("localhost", port)).await.unwrap());
    }
    let mut listener = subscribe(port, "/chatter").await;
    until("it is taken in", async || (publisher.subscribers().len() == 1).then_some(())).await;
    publisher.publish(string("well")).unwrap();
    assert_eq!(timeout(LIMIT, read_frame(&mut listener)).await.unwrap(), string("well"));
}

#[tokio::test]
async fn a_slow_reader_costs_a_bounded_queue_and_nobody_else_a_message() {
    // More bytes than the sockets between hold, and the queue.
    const MESSAGES: usize = 500;
    let master = Master::start().await;
    let node = master.node("/bridge").await;
    let queue = QueueLimits { messages: MESSAGES, bytes: 4 << 20 };
    let publisher = node.publish("/big", string_type(), PublishOptions { queue, latch: false }).unwrap();
    let port = tcpros_port(&node, "/big").await;
    let slow = subscribe(port, "/big").await;
    let mut quick = subscribe(port, "/big").await;
    until("both are taken in", async || (publisher.subscribers().len() == 2).then_some(())).await;
    let message = |i: usize| string(&format!("{i:060000}"));
    for i in 0..MESSAGES {
        publisher.publish(message(i)).unwrap();
        assert_eq!(timeout(LIMIT, read_frame(&mut quick)).await.unwrap(), message(i));
    }
    let mut dropped: Vec<u64> = publisher.subscribers().iter().map(|subscriber| subscriber.dropped).collect();
    dropped.sort();
    assert!(dropped[0] == 0 && dropped[1] > 0, "{dropped:?}");
    assert_eq!(publisher.dropped(), dropped[1]);
    drop(slow);
    until("it is gone", async || (publisher.subscribers().len() == 1).then_some(())).await;
    assert_eq!(publisher.dropped(), dropped[1], "what was lost stays counted");
}

#[tokio::test]
async fn publishers_that_lie_are_left_and_others_are_heard() {
    let master = Master::start().await;
    let node = master.node("/bridge").await;
    let mut subscription = node.subscribe("/chatter", SubscribeOptions::default()).unwrap();
    // What the master itself says of the topic is over then, until somebody publishes.
    registered(&node).await;
    let header = Header::new([("callerid", "/liar"), ("md5sum", "x"), ("type", "a/B"), ("message_definition", "")]);
    let field = |header: &Header| header.encode();
    let liars = [
        ("max_message", [field(&header), b"\xff\xff\xff\xff".to_vec()].concat()),
        ("a header of", b"\xff\xff\xff\xff".to_vec()),
        ("field", b"\x08\0\0\0\xff\xff\xff\x7fa=b!".to_vec()),
        ("\"type\"", Header::new([("callerid", "/liar")]).encode()),
        ("refuses: go away", Header::new([("error", "go away")]).encode()),
        ("closed", [field(&header), b"\x08\0\0\0abc".to_vec()].concat()),
    ];
    let mut uris = Vec::new();
    for (_, says) in &liars {
        uris.push(liar(says.clone()).await);
    }
    // Not even a publisher, and not even a URI.
    uris.extend(["http://localhost:1/".to_owned(), "nonsense".to_owned()]);
    let update = |publishers: &[String]| {
        let publishers = Value::array(publishers.iter().map(String::as_str));
        call(&node, "publisherUpdate", vec!["/master".into(), "/chatter".into(), publishers])
    };
    update(&uris).await;
    for (uri, (reason, _)) in uris.iter().zip(&liars) {
        until(reason, async || failure(&subscription, uri).filter(|failed| failed.contains(reason))).await;
    }
    for uri in &uris[liars.len()..] {
        until(uri, async || failure(&subscription, uri)).await;
    }
    let other = master.node("/other").await;
    let publisher =
        other.publish("/chatter", string_type(), PublishOptions { latch: true, ..Default::default() }).unwrap();
    publisher.publish(string("the truth")).unwrap();
    assert_eq!(next_text(&mut subscription).await, ("the truth".to_owned(), "/other".to_owned()));
}

#[tokio::test]
async fn the_slave_api_answers_tools_and_refuses_bombs() {
    let master = Master::start().await;
    let node = master.node("/bridge").await;
    let _publisher = node.publish("/chatter", string_type(), PublishOptions::default()).unwrap();
    let subscription = node.subscribe("/in", SubscribeOptions::default()).unwrap();
    let deep = "<value><array><data>".repeat(20_000);
    let bomb =
        "<!DOCTYPE a [<!ENTITY b \"bbbbbbbb\"><!ENTITY c \"&b;&b;&b;&b;&b;&b;&b;&b;\">]><methodCall>&c;</methodCall>";
    for body in [format!("<methodCall><methodName>getPid</methodName><params><param>{deep}"), bomb.to_owned()] {
        let answer = post(&node, body.as_bytes()).await;
        let body = &answer[answer.find("<?xml").unwrap()..];
        assert!(decode_response(body.as_bytes()).unwrap().is_err(), "{answer}");
    }
    let long = vec![b'a'; (1 << 20) + 1];
    assert!(post(&node, &long).await.starts_with("HTTP/1.1 413"));
    let mut endless = TcpStream::connect(address(&node)).await.unwrap();
    // A head that is never over ends the connection once it is too long.
    let ended = async { while endless.write_all(&[b'a'; 4096]).await.is_ok() {} };
    assert!(timeout(LIMIT, ended).await.is_ok());

    let topics = |topic: &str, kind: &str| Value::Array(vec![Value::array([topic, kind])]);
    for (method, expected) in [
        ("getPid", Value::Int(std::process::id() as i32)),
        ("getMasterUri", master.config("/x").master_uri.into()),
        ("getPublications", topics("/chatter", "std_msgs/String")),
        ("getSubscriptions", topics("/in", "*")),
        ("getBusInfo", Value::Array(vec![])),
        ("getBusStats", Value::Array(vec![Value::Array(vec![]); 3])),
    ] {
        assert_eq!(call(&node, method, vec!["/tool".into()]).await, expected, "{method}");
    }
    call(&node, "paramUpdate", vec!["/master".into(), "/p".into(), 1.into()]).await;
    call(&node, "shutdown", vec!["/tool".into(), "enough".into()]).await;
    assert_eq!(node.status().borrow().shutdown.as_deref(), Some("by /tool: enough"));
    // It is for whoever uses the node to decide.
    assert_eq!(call(&node, "getPid", vec!["/tool".into()]).await, Value::Int(std::process::id() as i32));
    drop(subscription);
}

/// Why a source is not connected.
fn failure(subscription: &Subscription, uri: &str) -> Option<String> {
    match subscription.sources().borrow().get(uri)? {
        SourceState::Failed(reason) => Some(reason.clone()),
        _ => None,
    }
}

/// A publisher whose slave API is right, and which says this to all who connect; the URI of its
/// slave API.
async fn liar(says: Vec<u8>) -> String {
    let [api, tcpros] =
        [TcpListener::bind("127.0.0.1:0").await.unwrap(), TcpListener::bind("127.0.0.1:0").await.unwrap()];
    let port = i32::from(tcpros.local_addr().unwrap().port());
    let uri = format!("http://localhost:{}/", api.local_addr().unwrap().port());
    tokio::spawn(async move {
        loop {
            let (mut stream, _) = api.accept().await.unwrap();
            let mut request = Vec::new();
            while !request.ends_with(b"</methodCall>\n") {
                assert!(stream.read_buf(&mut request).await.unwrap() > 0);
            }
            let body = request.windows(5).position(|window| window == b"<?xml").unwrap();
            assert_eq!(decode_call(&request[body..]).unwrap().method, "requestTopic");
            let params = Value::Array(vec!["TCPROS".into(), "localhost".into(), port.into()]);
            let answer = encode_response(&Ok(Value::Array(vec![1.into(), "".into(), params])));
            let head = format!("HTTP/1.0 200 OK\r\nContent-length: {}\r\n\r\n", answer.len());
            stream.write_all((head + &answer).as_bytes()).await.unwrap();
        }
    });
    tokio::spawn(async move {
        loop {
            let (mut stream, _) = tcpros.accept().await.unwrap();
            read_header(&mut stream).await;
            // It may have had enough before the end.
            _ = stream.write_all(&says).await;
        }
    });
    uri
}

/// A subscriber that has read the header and nothing else.
async fn subscribe(port: u16, topic: &str) -> TcpStream {
    let mut stream = TcpStream::connect(("localhost", port)).await.unwrap();
    let header = Header::new([("callerid", "/raw"), ("md5sum", "*"), ("topic", topic), ("type", "*")]);
    stream.write_all(&header.encode()).await.unwrap();
    let theirs = read_header(&mut stream).await;
    assert_eq!(theirs.get("callerid"), Some("/bridge"));
    stream
}

async fn read_header(stream: &mut TcpStream) -> Header {
    Header::decode(&timeout(LIMIT, read_frame(stream)).await.expect("a header")).unwrap()
}

async fn read_frame(stream: &mut TcpStream) -> Bytes {
    let mut bytes = vec![0; stream.read_u32_le().await.unwrap() as usize];
    stream.read_exact(&mut bytes).await.unwrap();
    bytes.into()
}

async fn tcpros_port(node: &Node, topic: &str) -> u16 {
    let protocols = Value::Array(vec![Value::array(["TCPROS"])]);
    let answer = call(node, "requestTopic", vec!["/raw".into(), topic.into(), protocols]).await;
    let [_, _, port] = answer.into_tuple().unwrap();
    port.into_int().unwrap().try_into().unwrap()
}

/// Calls the node's slave API; the value of an answer that says that all is well.
async fn call(node: &Node, method: &str, params: Vec<Value>) -> Value {
    let request = encode_call(&Call { method: method.to_owned(), params });
    let answer = post(node, request.as_bytes()).await;
    let body = &answer[answer.find("<?xml").unwrap_or_else(|| panic!("{method}: {answer}"))..];
    let [code, _, value] = decode_response(body.as_bytes()).unwrap().unwrap().into_tuple().unwrap();
    assert_eq!(code, Value::Int(1), "{method}");
    value
}

/// The whole answer to a POST, head and all.
async fn post(node: &Node, body: &[u8]) -> String {
    let mut stream = TcpStream::connect(address(node)).await.unwrap();
    let head = format!("POST / HTTP/1.1\r\nHost: x\r\nConnection: close\r\nContent-Length: {}\r\n\r\n", body.len());
    stream.write_all(head.as_bytes()).await.unwrap();
    // It may be refused before all is written.
    _ = stream.write_all(body).await;
    let mut answer = Vec::new();
    let mut part = [0; 4096];
    let read = async {
        while let Ok(length @ 1..) = stream.read(&mut part).await {
            answer.extend_from_slice(&part[..length]);
        }
    };
    timeout(Duration::from_secs(20), read).await.expect("an answer");
    String::from_utf8(answer).unwrap()
}

/// Of the node's slave API.
fn address(node: &Node) -> String {
    node.uri().trim_start_matches("http://").trim_end_matches('/').to_owned()
}
