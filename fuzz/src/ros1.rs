//! What masters, nodes and tools of ROS 1 say to a node.

use gdp_ros1::Header;
use gdp_ros1::xmlrpc::{Call, Fault, Value, decode_call, decode_response, encode_call, encode_response};

/// What is taken for a call or an answer is the same again when it is written by us.
pub fn xmlrpc(data: &[u8]) {
    if let Ok(call) = decode_call(data) {
        assert_eq!(decode_call(encode_call(&call).as_bytes()).expect("what was decoded"), call);
    }
    if let Ok(response) = decode_response(data) {
        let again = decode_response(encode_response(&response).as_bytes()).expect("what was decoded");
        assert_eq!(again, response);
    }
}

/// What is taken for a connection header is the same again when it is written by us.
pub fn ros1_header(data: &[u8]) {
    let Ok(header) = Header::decode(data) else { return };
    assert_eq!(Header::decode(&header.encode()[4..]), Ok(header));
}

pub fn documents() -> Vec<(String, Vec<u8>)> {
    let call = |method: &str, params: Vec<Value>| encode_call(&Call { method: method.to_owned(), params });
    let topic = || ["/node", "/chatter"].map(Value::from);
    let state = Value::Array(vec![Value::Array(vec!["/chatter".into(), Value::array(["/a", "/b"])])]);
    let fault = Fault { code: 1, text: "there is no method \"x\"".to_owned() };
    [
        ("getPid", call("getPid", vec!["/node".into()])),
        (
            "requestTopic",
            call("requestTopic", [&topic()[..], &[Value::Array(vec![Value::array(["TCPROS"])])]].concat()),
        ),
        ("publisherUpdate", call("publisherUpdate", [&topic()[..], &[Value::array(["http://a:1/"])]].concat())),
        ("a truth value", call("paramUpdate", vec![true.into(), (-1).into()])),
        ("an answer", encode_response(&Ok(Value::Array(vec![1.into(), "a < b\r".into(), state])))),
        ("a fault", encode_response(&Err(fault))),
    ]
    .map(|(name, xml)| (name.to_owned(), xml.into_bytes()))
    .to_vec()
}

pub fn headers() -> Vec<(String, Vec<u8>)> {
    let subscriber = [("callerid", "/a"), ("md5sum", "*"), ("tcp_nodelay", "1"), ("topic", "/chatter"), ("type", "*")];
    let publisher =
        [("latching", "1"), ("md5sum", "992c"), ("message_definition", "string data\n# a=b\n"), ("type", "a/B")];
    [
        ("of a subscriber", Header::new(subscriber)),
        ("of a publisher", Header::new(publisher)),
        ("an error", Header::new([("error", "no")])),
    ]
    .map(|(name, header)| (name.to_owned(), header.encode()[4..].to_vec()))
    .to_vec()
}
