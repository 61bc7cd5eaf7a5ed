//! Encodes calls and responses as compact XML. It writes no empty-element tags, because roscpp's
//! own small parser does not accept them.

use std::fmt::Write;

use quick_xml::escape::escape;

use super::{Call, Fault, Value, is_allowed};

const DECLARATION: &str = "<?xml version=\"1.0\"?>\n";

/// Encodes the body of a request.
pub fn encode_call(call: &Call) -> String {
    let mut xml = format!("{DECLARATION}<methodCall><methodName>{}</methodName><params>", text(&call.method));
    for param in &call.params {
        xml.push_str("<param>");
        value(&mut xml, param);
        xml.push_str("</param>");
    }
    xml.push_str("</params></methodCall>\n");
    xml
}

/// Encodes the body of a response.
pub fn encode_response(response: &Result<Value, Fault>) -> String {
    let mut xml = format!("{DECLARATION}<methodResponse>");
    match response {
        Ok(answer) => {
            xml.push_str("<params><param>");
            value(&mut xml, answer);
            xml.push_str("</param></params>");
        }
        Err(Fault { code, text }) => {
            xml.push_str("<fault>");
            let members = [("faultCode", Value::Int(*code)), ("faultString", Value::String(text.clone()))];
            value(&mut xml, &Value::Struct(members.map(|(name, value)| (name.to_owned(), value)).into()));
            xml.push_str("</fault>");
        }
    }
    xml.push_str("</methodResponse>\n");
    xml
}

fn value(xml: &mut String, value: &Value) {
    xml.push_str("<value>");
    match value {
        // Writing to a string cannot fail.
        Value::Int(int) => _ = write!(xml, "<i4>{int}</i4>"),
        Value::Bool(bool) => _ = write!(xml, "<boolean>{}</boolean>", u8::from(*bool)),
        Value::String(string) => _ = write!(xml, "<string>{}</string>", text(string)),
        Value::Array(values) => {
            xml.push_str("<array><data>");
            values.iter().for_each(|element| self::value(xml, element));
            xml.push_str("</data></array>");
        }
        Value::Struct(members) => {
            xml.push_str("<struct>");
            for (name, member) in members {
                _ = write!(xml, "<member><name>{}</name>", text(name));
                self::value(xml, member);
                xml.push_str("</member>");
            }
            xml.push_str("</struct>");
        }
    }
    xml.push_str("</value>");
}

/// Escapes a text. Carriage returns become character references, because a parser would read them
/// as line feeds. Characters that XML forbids are left out.
fn text(raw: &str) -> String {
    let kept: String = raw.chars().filter(|&c| is_allowed(c)).collect();
    escape(&kept).replace('\r', "&#13;")
}
