//! Who may ask. The comparison of tokens takes the same time wherever they differ.

use std::fmt;
use std::io::Read;
use std::net::IpAddr;
use std::ops::RangeInclusive;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use hyper::header::{AUTHORIZATION, COOKIE, HOST};
use hyper::{Request, StatusCode};
use subtle::ConstantTimeEq;
use zeroize::Zeroizing;

use crate::error::HttpError;

/// Length of a token in bytes. 16 random letters are too many to guess.
pub const TOKEN_BYTES: RangeInclusive<usize> = 16..=256;

/// The query parameter that carries the token into a browser.
const PARAMETER: &str = "token";

/// A secret that a client presents.
pub struct AccessToken(Zeroizing<String>);

impl AccessToken {
    /// Returns a new token of 256 random bits, in hex.
    ///
    /// # Errors
    ///
    /// Fails if the system has no random numbers.
    pub fn random() -> Result<Self, getrandom::Error> {
        let mut bytes = Zeroizing::new([0; 32]);
        getrandom::fill(&mut *bytes)?;
        Ok(Self(Zeroizing::new(hex::encode(*bytes))))
    }

    /// Reads a token: the content of the file, without spaces around it.
    ///
    /// # Errors
    ///
    /// Fails if the file cannot be read, if others than its owner and group may read it, and if its
    /// content is no token.
    pub fn from_file(path: &Path) -> Result<Self, HttpError> {
        let read = |source| HttpError::Read { path: path.into(), source };
        let file = std::fs::File::open(path).map_err(read)?;
        if file.metadata().map_err(read)?.permissions().mode() & 0o007 != 0 {
            return Err(HttpError::Exposed(path.into()));
        }
        let mut text = Zeroizing::new(String::new());
        file.take(4096).read_to_string(&mut text).map_err(read)?;
        Self::parse(text.trim()).ok_or_else(|| HttpError::Token(path.into()))
    }

    /// Returns a token if the text is one: visible ASCII, [`TOKEN_BYTES`] long.
    pub fn parse(text: &str) -> Option<Self> {
        let is_token = TOKEN_BYTES.contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_graphic());
        is_token.then(|| Self(Zeroizing::new(text.to_owned())))
    }

    /// The token itself, for whoever hands it to a user. Never log it.
    pub fn secret(&self) -> &str {
        &self.0
    }

    fn is(&self, presented: &[u8]) -> bool {
        self.0.as_bytes().ct_eq(presented).into()
    }
}

impl fmt::Debug for AccessToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("AccessToken(…)")
    }
}

/// Who may ask.
#[derive(Debug)]
pub struct Access {
    token: Option<AccessToken>,
    cookie: Option<&'static str>,
}

/// What a request may have.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Admission {
    Granted,
    Refused(StatusCode, &'static str),
    /// The token is in the address: a browser keeps it as this cookie, and asks for the path alone.
    Keep(String),
}

impl Access {
    /// Everybody on this machine. The listener must then be on loopback.
    pub fn open_on_loopback() -> Self {
        Self { token: None, cookie: None }
    }

    /// Whoever presents the token: `Authorization: Bearer TOKEN`.
    pub fn token(token: AccessToken) -> Self {
        Self { token: Some(token), cookie: None }
    }

    /// As [`Self::token`], and browsers: the address `/PATH?token=TOKEN` sets a cookie of this
    /// name, which scripts cannot read and other sites cannot use, and leads to `/PATH`.
    pub fn token_or_cookie(token: AccessToken, cookie: &'static str) -> Self {
        Self { token: Some(token), cookie: Some(cookie) }
    }

    /// Whether other machines may be let in.
    pub(crate) fn has_token(&self) -> bool {
        self.token.is_some()
    }

    pub(crate) fn admit<B>(&self, request: &Request<B>) -> Admission {
        if let Some(token) = &self.token
            && bearer(request).is_some_and(|presented| token.is(presented))
        {
            return Admission::Granted;
        }
        if !names_this_machine(request) {
            return Admission::Refused(
                StatusCode::MISDIRECTED_REQUEST,
                "ask for an IP address or localhost, not for another name",
            );
        }
        let Some(token) = &self.token else { return Admission::Granted };
        let Some(cookie) = self.cookie else {
            return Admission::Refused(StatusCode::UNAUTHORIZED, "a bearer token is needed");
        };
        if cookies(request).any(|(name, value)| name == cookie && token.is(value.as_bytes())) {
            return Admission::Granted;
        }
        let query = form_urlencoded::parse(request.uri().query().unwrap_or_default().as_bytes());
        let mut presented = query.filter(|(key, _)| key == PARAMETER);
        if presented.next().is_some_and(|(_, value)| token.is(value.as_bytes())) {
            let secret = token.secret();
            return Admission::Keep(format!("{cookie}={secret}; Path=/; HttpOnly; SameSite=Strict"));
        }
        Admission::Refused(StatusCode::UNAUTHORIZED, "open the address that has the token")
    }
}

/// Returns the token of an `Authorization` header.
fn bearer<B>(request: &Request<B>) -> Option<&[u8]> {
    let value = request.headers().get(AUTHORIZATION)?.as_bytes();
    let (scheme, presented) = value.split_at_checked(7)?;
    scheme.eq_ignore_ascii_case(b"bearer ").then(|| presented.trim_ascii())
}

fn cookies<B>(request: &Request<B>) -> impl Iterator<Item = (&str, &str)> {
    let headers = request.headers().get_all(COOKIE).into_iter().filter_map(|value| value.to_str().ok());
    headers.flat_map(|value| value.split(';')).filter_map(|pair| pair.trim().split_once('='))
}

/// Whether the request has exactly one `Host`, which is an IP address or `localhost`.
fn names_this_machine<B>(request: &Request<B>) -> bool {
    let mut hosts = request.headers().get_all(HOST).into_iter();
    let (Some(host), None) = (hosts.next(), hosts.next()) else { return false };
    let Ok(host) = host.to_str() else { return false };
    // A request line with a whole address would say something else.
    if request.uri().host().is_some() {
        return false;
    }
    if let Some((address, port)) = host.strip_prefix('[').and_then(|host| host.split_once(']')) {
        return address.parse::<std::net::Ipv6Addr>().is_ok() && is_port(port);
    }
    let (name, port) = host.find(':').map_or((host, ""), |colon| host.split_at(colon));
    is_port(port) && (name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok_and(|ip| ip.is_ipv4()))
}

/// Whether a text is empty, or a colon and a port.
fn is_port(text: &str) -> bool {
    text.is_empty() || text.strip_prefix(':').is_some_and(|port| port.parse::<u16>().is_ok())
}

#[cfg(test)]
#[path = "../tests/unit/access.rs"]
mod tests;
