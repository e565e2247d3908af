//! Decides which requests are answered: those of the page that the printed URL names.
//!
//! | check | keeps out |
//! | --- | --- |
//! | the token, the first segment of each path | other users and other programs of this machine |
//! | `Host` is the address listened on, or `localhost` | pages of names that resolve to this address (DNS rebinding) |
//! | `Origin` is absent, or is that host | pages of other origins that know the token |

use std::{
    hint, io,
    net::{IpAddr, SocketAddr},
};

use hyper::{
    HeaderMap, Uri,
    header::{HOST, ORIGIN},
    http::uri::Authority,
};

/// The length of a token in bytes, before it is written in hex digits.
const TOKEN_BYTES: usize = 16;

/// The address listened on, and the token.
#[derive(Debug)]
pub(super) struct Access {
    address: SocketAddr,
    token: String,
}

/// The reason why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum Refused {
    #[error("refused: the Host of the request is not the address of this server")]
    Host,
    #[error("refused: the request comes from a page of another origin")]
    Origin,
    #[error("refused: use the URL that `sm2 view` has printed, with its token")]
    Token,
}

impl Access {
    /// Creates a token.
    ///
    /// # Errors
    ///
    /// The operating system has no random bytes.
    pub(super) fn new(address: SocketAddr) -> io::Result<Self> {
        let mut bytes = [0; TOKEN_BYTES];
        getrandom::fill(&mut bytes)?;
        let token = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(Self { address, token })
    }

    /// The URL of the page. Relative URLs of the page keep the token.
    pub(super) fn url(&self) -> String {
        let Self { address, token } = self;
        format!("http://{address}/{token}/")
    }

    /// Checks a request. Returns the path behind the token, such as `api/domain`.
    ///
    /// # Errors
    ///
    /// The first check that failed.
    pub(super) fn check<'a>(&self, headers: &HeaderMap, uri: &'a Uri) -> Result<&'a str, Refused> {
        let host = headers.get(HOST).and_then(|it| it.to_str().ok());
        let host = host.filter(|it| self.is_own(it)).ok_or(Refused::Host)?;
        if let Some(origin) = headers.get(ORIGIN) {
            let origin = origin.to_str().ok();
            let origin = origin.and_then(|it| it.strip_prefix("http://"));
            if !origin.is_some_and(|it| it.eq_ignore_ascii_case(host)) {
                return Err(Refused::Origin);
            }
        }
        let path = uri
            .path()
            .strip_prefix('/')
            .and_then(|it| it.split_once('/'));
        match path {
            Some((token, rest)) if self.is_token(token) => Ok(rest),
            _ => Err(Refused::Token),
        }
    }

    /// Whether a `Host` names this server. The port may be another one, that of a tunnel.
    fn is_own(&self, host: &str) -> bool {
        let Ok(host) = host.parse::<Authority>() else {
            return false;
        };
        let host = host.host().trim_matches(['[', ']']);
        match host.parse::<IpAddr>() {
            Ok(ip) => self.address.ip().is_unspecified() || ip == self.address.ip(),
            Err(_) => host.eq_ignore_ascii_case("localhost"),
        }
    }

    /// Compares in a time that does not depend on where a wrong token differs.
    fn is_token(&self, given: &str) -> bool {
        let pairs = given.bytes().zip(self.token.bytes());
        let difference = pairs.fold(0, |sum, (given, ours)| {
            hint::black_box(sum | (given ^ ours))
        });
        given.len() == self.token.len() && difference == 0
    }
}

#[cfg(test)]
mod tests;
