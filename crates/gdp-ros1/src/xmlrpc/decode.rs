//! Decodes XML to calls and responses, by recursive descent with bounds on depth and number of
//! values.

use std::str::Utf8Error;

use quick_xml::Reader;
use quick_xml::escape::resolve_xml_entity;
use quick_xml::events::Event;

use super::{Call, Fault, Value, is_allowed};

/// Maximum depth of nested arrays and structures. `getSystemState` needs five.
pub const MAX_DEPTH: usize = 16;

/// Maximum number of values in one call or response. An array and each of its elements count.
pub const MAX_VALUES: usize = 1 << 18;

/// The reason why a body is not XML-RPC, or exceeds a bound.
#[derive(Debug, thiserror::Error)]
pub enum XmlRpcError {
    #[error("not XML: {0}")]
    Xml(#[from] quick_xml::Error),
    #[error("not UTF-8: {0}")]
    Encoding(#[from] Utf8Error),
    #[error("{wanted} was expected at byte {at}")]
    Unexpected { wanted: &'static str, at: u64 },
    #[error("the entity {0:?} is not one of XML's own")]
    Entity(String),
    #[error("a document type is not taken")]
    DocumentType,
    #[error("values nested deeper than {MAX_DEPTH}")]
    Depth,
    #[error("more than {MAX_VALUES} values")]
    Values,
    #[error("{0:?} is not a type of ROS 1's master and slave API")]
    Type(String),
}

/// Decodes the body of a request.
pub fn decode_call(body: &[u8]) -> Result<Call, XmlRpcError> {
    let mut tokens = Tokens::new(body)?;
    tokens.open("methodCall")?;
    tokens.open("methodName")?;
    let method = tokens.text()?.trim().to_owned();
    tokens.close()?;
    let mut params = Vec::new();
    // A call without parameters may omit `params`.
    if tokens.opens("params")? {
        while tokens.opens("param")? {
            params.push(tokens.value(0)?);
            tokens.close()?;
        }
        tokens.close()?;
    }
    tokens.close()?;
    tokens.end()?;
    Ok(Call { method, params })
}

/// Decodes the body of a response: one value or a fault.
pub fn decode_response(body: &[u8]) -> Result<Result<Value, Fault>, XmlRpcError> {
    let mut tokens = Tokens::new(body)?;
    tokens.open("methodResponse")?;
    let response = if tokens.opens("fault")? {
        Err(fault(tokens.value(0)?))
    } else {
        tokens.open("params")?;
        tokens.open("param")?;
        let value = tokens.value(0)?;
        tokens.close()?;
        Ok(value)
    };
    tokens.close()?;
    tokens.close()?;
    tokens.end()?;
    Ok(response)
}

fn fault(value: Value) -> Fault {
    let (mut code, mut text) = (0, String::from("no reason given"));
    if let Value::Struct(members) = value {
        for member in members {
            match member {
                (name, Value::Int(int)) if name == "faultCode" => code = int,
                (name, Value::String(string)) if name == "faultString" => text = string,
                _ => {}
            }
        }
    }
    Fault { code, text }
}

#[derive(Debug)]
enum Token {
    Open(String),
    Close,
    Text(String),
    End,
}

/// A tokenizer of XML with one token of lookahead.
struct Tokens<'a> {
    reader: Reader<&'a [u8]>,
    ahead: Option<Token>,
    values: usize,
}

impl<'a> Tokens<'a> {
    fn new(body: &'a [u8]) -> Result<Self, XmlRpcError> {
        let mut reader = Reader::from_str(std::str::from_utf8(body)?);
        reader.config_mut().expand_empty_elements = true;
        Ok(Self { reader, ahead: None, values: 0 })
    }

    fn next(&mut self) -> Result<Token, XmlRpcError> {
        if let Some(token) = self.ahead.take() {
            return Ok(token);
        }
        let mut text = String::new();
        loop {
            let token = match self.reader.read_event()? {
                Event::Text(part) => {
                    text.push_str(&part.xml10_content());
                    continue;
                }
                Event::CData(part) => {
                    text.push_str(&part.xml10_content());
                    continue;
                }
                Event::GeneralRef(reference) => {
                    match reference.resolve_char_ref()? {
                        Some(char) => text.push(char),
                        None => text.push_str(
                            resolve_xml_entity(&reference).ok_or_else(|| XmlRpcError::Entity(short(&reference)))?,
                        ),
                    }
                    continue;
                }
                Event::Comment(_) | Event::Decl(_) | Event::PI(_) => continue,
                Event::DocType(_) => return Err(XmlRpcError::DocumentType),
                Event::Start(tag) => Token::Open(short(tag.name().as_ref())),
                Event::End(_) => Token::Close,
                Event::Empty(_) => unreachable!("empty elements are expanded"),
                Event::Eof => Token::End,
            };
            if text.is_empty() {
                return Ok(token);
            }
            if !text.chars().all(is_allowed) {
                return self.unexpected("a character that XML has");
            }
            self.ahead = Some(token);
            return Ok(Token::Text(text));
        }
    }

    /// Returns the next token, and skips white space between elements.
    fn next_element(&mut self) -> Result<Token, XmlRpcError> {
        match self.next()? {
            Token::Text(text) if text.trim().is_empty() => self.next(),
            token => Ok(token),
        }
    }

    fn unexpected<T>(&self, wanted: &'static str) -> Result<T, XmlRpcError> {
        Err(XmlRpcError::Unexpected { wanted, at: self.reader.buffer_position() })
    }

    fn open(&mut self, name: &'static str) -> Result<(), XmlRpcError> {
        match self.next_element()? {
            Token::Open(found) if found == name => Ok(()),
            _ => self.unexpected(name),
        }
    }

    /// Opens the element if it comes next. Otherwise consumes nothing and returns false.
    fn opens(&mut self, name: &str) -> Result<bool, XmlRpcError> {
        match self.next_element()? {
            Token::Open(found) if found == name => Ok(true),
            token => {
                // `next_element` may have skipped white space, which has no meaning here.
                self.ahead = Some(token);
                Ok(false)
            }
        }
    }

    fn close(&mut self) -> Result<(), XmlRpcError> {
        match self.next_element()? {
            Token::Close => Ok(()),
            _ => self.unexpected("the end of the element"),
        }
    }

    fn end(&mut self) -> Result<(), XmlRpcError> {
        match self.next_element()? {
            Token::End => Ok(()),
            _ => self.unexpected("the end of the document"),
        }
    }

    /// Returns the text up to the next tag.
    fn text(&mut self) -> Result<String, XmlRpcError> {
        match self.next()? {
            Token::Text(text) => Ok(text),
            token => {
                self.ahead = Some(token);
                Ok(String::new())
            }
        }
    }

    /// Reads a whole `value` element.
    fn value(&mut self, depth: usize) -> Result<Value, XmlRpcError> {
        self.values += 1;
        if self.values > MAX_VALUES {
            return Err(XmlRpcError::Values);
        }
        self.open("value")?;
        let text = self.text()?;
        match self.next()? {
            // A value without a type is a string, including its white space.
            Token::Close => Ok(Value::String(text)),
            Token::Open(kind) if text.trim().is_empty() => {
                let value = self.typed(&kind, depth)?;
                self.close()?;
                self.close()?;
                Ok(value)
            }
            _ => self.unexpected("a type or the end of the value"),
        }
    }

    /// Reads the content of the element that names the type. The element stays open.
    fn typed(&mut self, kind: &str, depth: usize) -> Result<Value, XmlRpcError> {
        Ok(match kind {
            "i4" | "int" => match self.text()?.trim().parse() {
                Ok(int) => Value::Int(int),
                Err(_) => return self.unexpected("an integer of 32 bits"),
            },
            "boolean" => match self.text()?.trim() {
                "0" => Value::Bool(false),
                "1" => Value::Bool(true),
                _ => return self.unexpected("0 or 1"),
            },
            "string" => Value::String(self.text()?),
            "array" | "struct" if depth == MAX_DEPTH => return Err(XmlRpcError::Depth),
            "array" => {
                self.open("data")?;
                let mut values = Vec::new();
                while self.ahead_is_value()? {
                    values.push(self.value(depth + 1)?);
                }
                self.close()?;
                Value::Array(values)
            }
            "struct" => {
                let mut members = Vec::new();
                while self.opens("member")? {
                    self.open("name")?;
                    let name = self.text()?;
                    self.close()?;
                    members.push((name, self.value(depth + 1)?));
                    self.close()?;
                }
                Value::Struct(members)
            }
            other => return Err(XmlRpcError::Type(other.to_owned())),
        })
    }

    fn ahead_is_value(&mut self) -> Result<bool, XmlRpcError> {
        let token = self.next_element()?;
        let is_value = matches!(&token, Token::Open(name) if name == "value");
        self.ahead = Some(token);
        Ok(is_value)
    }
}

/// Returns the first 32 characters of an unknown element name, for an error message.
fn short(name: &str) -> String {
    name.chars().take(32).collect()
}
