//! Who may ask. The comparison of tokens takes the same time wherever they differ.

use std::fmt;
use std::io::Read;
use std::net::IpAddr;
use std::ops::RangeInclusive;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use hyper::header::{AUTHORIZATION, COOKIE, HOST};
use hyper::{Request, StatusCode};
use sha2::{Digest, Sha256};
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

    /// Returns a token if the text is one, [`TOKEN_BYTES`] long. Its characters stand for themselves
    /// in an address and in a header.
    pub fn parse(text: &str) -> Option<Self> {
        let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"._~-".contains(&byte);
        let is_token = TOKEN_BYTES.contains(&text.len()) && text.bytes().all(is_plain);
        is_token.then(|| Self(Zeroizing::new(text.to_owned())))
    }

    /// The token itself, for whoever hands it to a user. Never log it.
    pub fn secret(&self) -> &str {
        &self.0
    }

    fn is(&self, presented: &[u8]) -> bool {
        self.0.as_bytes().ct_eq(presented).into()
    }

    /// Returns the hash of the token for a purpose.
    fn derived(&self, purpose: &str) -> Zeroizing<String> {
        let hash = Sha256::new().chain_update(purpose).chain_update([0]).chain_update(self.0.as_bytes());
        Zeroizing::new(hex::encode(hash.finalize()))
    }
}

/// What a browser keeps instead of the token. It sends that to each port of the same host, so the
/// name differs between tokens, and the value does not tell the token.
struct Cookie {
    name: String,
    value: Zeroizing<String>,
}

impl Cookie {
    fn of(token: &AccessToken, prefix: &str) -> Self {
        Self {
            name: format!("{prefix}_{}", &token.derived("gdp-http cookie name")[..8]),
            value: token.derived("gdp-http cookie value"),
        }
    }

    fn is(&self, (name, value): (&str, &str)) -> bool {
        name == self.name && bool::from(self.value.as_bytes().ct_eq(value.as_bytes()))
    }
}

impl fmt::Debug for Cookie {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Cookie({}=…)", self.name)
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
    cookie: Option<Cookie>,
}

/// What a request may have.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Admission {
    Granted,
    Refused(StatusCode, &'static str),
    /// A token is in the address: a browser asks for the path alone, and keeps this cookie if the
    /// token is right.
    Redirect(Option<String>),
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

    /// As [`Self::token`], and browsers: the address `/PATH?token=TOKEN` sets a cookie, which
    /// scripts cannot read and other sites cannot use, and leads to `/PATH`. The cookie's name is
    /// `prefix`, an underscore and a short hash of the token. Its value is another hash.
    pub fn token_or_cookie(token: AccessToken, prefix: &str) -> Self {
        let cookie = Some(Cookie::of(&token, prefix));
        Self { token: Some(token), cookie }
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
        let Some(cookie) = &self.cookie else {
            return Admission::Refused(StatusCode::UNAUTHORIZED, "a bearer token is needed");
        };
        let has_cookie = cookies(request).any(|pair| cookie.is(pair));
        let query = form_urlencoded::parse(request.uri().query().unwrap_or_default().as_bytes());
        let presented = query.filter(|(key, _)| key == PARAMETER).map(|(_, value)| value).next();
        // Neither history nor screen keeps an address with a token, whether a cookie is there or not.
        match presented {
            Some(presented) if token.is(presented.as_bytes()) => {
                let Cookie { name, value } = cookie;
                let kept = format!("{name}={}; Path=/; HttpOnly; SameSite=Strict", value.as_str());
                return Admission::Redirect(Some(kept));
            }
            Some(_) if has_cookie => return Admission::Redirect(None),
            None if has_cookie => return Admission::Granted,
            _ => {}
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
