//! Unit tests of `api::slave`.

use super::*;

fn read(method: &str, params: &[Value]) -> Result<SlaveCall, Refusal> {
    Call { method: method.to_owned(), params: params.to_vec() }.try_into()
}

#[test]
fn calls_are_read() {
    let protocols = Value::Array(vec![Value::Array(vec!["UDPROS".into(), 1.into()]), Value::array(["TCPROS"])]);
    let [caller, topic] = ["/listener", "/chatter"].map(str::to_owned);
    let protocol_names = ["UDPROS", "TCPROS"].map(str::to_owned).into();
    assert_eq!(
        read("requestTopic", &["/listener".into(), "/chatter".into(), protocols]),
        Ok(SlaveCall::RequestTopic { caller, topic: topic.clone(), protocols: protocol_names })
    );
    let publishers = vec!["http://a:1/".to_owned()];
    assert_eq!(
        read("publisherUpdate", &["/master".into(), "/chatter".into(), Value::array(["http://a:1/"])]),
        Ok(SlaveCall::PublisherUpdate { topic, publishers })
    );
    let reason = String::new();
    assert_eq!(read("shutdown", &["/x".into()]), Ok(SlaveCall::Shutdown { caller: "/x".to_owned(), reason }));
    assert_eq!(read("getPid", &["/x".into()]), Ok(SlaveCall::Pid));
}

#[test]
fn what_is_no_call_is_refused() {
    assert!(matches!(read("system.listMethods", &[]), Err(Refusal::Unknown(_))));
    for (method, params) in [
        ("publisherUpdate", vec![]),
        ("publisherUpdate", ["/m", "/t", "http://a:1/"].map(Value::from).into()),
        ("requestTopic", vec!["/n".into(), "/t".into(), Value::array(["TCPROS"])]),
        ("requestTopic", vec!["/n".into(), 7.into(), Value::Array(vec![])]),
        ("shutdown", vec![]),
    ] {
        assert!(matches!(read(method, &params), Err(Refusal::Params(_))), "{method} {params:?}");
    }
}
