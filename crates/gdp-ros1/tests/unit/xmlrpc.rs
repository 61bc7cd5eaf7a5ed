use super::*;

#[test]
fn what_is_encoded_is_decoded_to_the_same() {
    let value = Value::Array(vec![
        Value::Int(-7),
        Value::Bool(true),
        Value::String("a < b && \"c\" ü \r\n\t".to_owned()),
        Value::String(String::new()),
        Value::Array(vec![]),
        Value::Struct(vec![("x".to_owned(), Value::Int(1)), ("y".to_owned(), Value::Array(vec![Value::Bool(false)]))]),
    ]);
    let call = Call { method: "registerPublisher".to_owned(), params: vec![value.clone(), "/chatter".into()] };
    assert_eq!(decode_call(encode_call(&call).as_bytes()).unwrap(), call);
    for response in [Ok(value), Err(Fault { code: 8, text: "no <such> method".to_owned() })] {
        assert_eq!(decode_response(encode_response(&response).as_bytes()).unwrap(), response);
    }
}

#[test]
fn forms_that_python_and_roscpp_write_are_read() {
    let python = b"<?xml version='1.0'?>\n<methodResponse>\n<params>\n<param>\n<value><array><data>\n<value><int>1</int></value>\n\
        <value><string></string></value>\n<value><array><data>\n</data></array></value>\n\
        </data></array></value>\n</param>\n</params>\n\
        </methodResponse>\n";
    let expected = Value::Array(vec![Value::Int(1), Value::String(String::new()), Value::Array(vec![])]);
    assert_eq!(decode_response(python).unwrap(), Ok(expected));
    let roscpp = b"<?xml version=\"1.0\"?>\r\n<methodCall><methodName>requestTopic</methodName>\r\n<params><param><value>/a node</value></param>\
        <param><value><string/></value></param><param><value/></param></params></methodCall>\r\n";
    let call = decode_call(roscpp).unwrap();
    assert_eq!(call.method, "requestTopic");
    assert_eq!(call.params, ["/a node", "", ""].map(Value::from));
    assert!(decode_call(b"<methodCall><methodName>getPid</methodName></methodCall>").unwrap().params.is_empty());
}

#[test]
fn hostile_documents_are_refused() {
    let call = |value: &str| {
        decode_call(
            format!("<methodCall><methodName>m</methodName><params><param><value>{value}</value></param></params></methodCall>").as_bytes(),
        )
    };
    let nested = |depth: usize| "<array><data><value>".repeat(depth) + &"</value></data></array>".repeat(depth);
    assert!(call(&nested(MAX_DEPTH)).is_ok());
    assert!(matches!(call(&nested(MAX_DEPTH + 1)), Err(XmlRpcError::Depth)));
    assert!(matches!(call(&"<array><data><value>".repeat(1 << 20)), Err(XmlRpcError::Depth)));
    let many = format!("<array><data>{}</data></array>", "<value/>".repeat(MAX_VALUES));
    assert!(matches!(call(&many), Err(XmlRpcError::Values)));
    assert!(matches!(call("&lol9;"), Err(XmlRpcError::Entity(_))));
    assert!(matches!(call("<base64>AAAA</base64>"), Err(XmlRpcError::Type(_))));
    assert!(call("<int>2147483648</int>").is_err());
    assert!(call("<int>1</i4>").is_err());
    assert!(call("&#1;").is_err());
    assert!(call("\u{1}").is_err());
    assert!(call("text<int>1</int>").is_err());
    assert!(call("<int>1</int><int>1</int>").is_err());
    let bomb = b"<!DOCTYPE b [<!ENTITY a \"aaaa\"><!ENTITY b \
                 \"&a;&a;&a;\">]><methodCall><methodName>&b;</methodName></methodCall>";
    assert!(matches!(decode_call(bomb), Err(XmlRpcError::DocumentType)));
    assert!(matches!(decode_call(b"<methodCall><methodName>\xff"), Err(XmlRpcError::Encoding(_))));
    assert!(decode_call(b"").is_err());
    assert!(decode_call(b"<methodCall><methodName>m</methodName></methodCall><more/>").is_err());
}
