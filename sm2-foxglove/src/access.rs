//! Decides which connections are accepted: those of a viewer that knows the printed URL.
//!
//! | check | keeps out |
//! | --- | --- |
//! | the token, the path of the URL | other users and other programs of this machine |
//! | `Host` is the address listened on, or `localhost` | pages of names that resolve to this address (DNS rebinding) |
//! | `Origin` is absent, local, Foxglove's, or allowed by an option | pages of other origins that know the token |

use std::{
    hint, io,
    net::{IpAddr, SocketAddr},
};

use tungstenite::http::{HeaderMap, Uri, header, uri::Authority};

/// The length of a token in bytes, before it is written in hex digits.
const TOKEN_BYTES: usize = 16;

/// The origin of Foxglove's application in a browser.
const FOXGLOVE: &str = "https://app.foxglove.dev";

/// The address listened on, the token, and the origins that are allowed besides local ones.
#[derive(Debug)]
pub(crate) struct Access {
    address: SocketAddr,
    token: String,
    origins: Vec<String>,
}

/// The reason why a connection is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Refused {
    #[error("refused: the Host of the request is not the address of this server")]
    Host,
    #[error("refused: the page has an origin that --allow-origin does not name")]
    Origin,
    #[error("refused: use the URL that sm2-foxglove has printed, with its token")]
    Token,
}

impl Access {
    /// Creates a token.
    ///
    /// # Errors
    ///
    /// The operating system has no random bytes.
    pub(crate) fn new(address: SocketAddr, origins: &[String]) -> io::Result<Self> {
        let mut bytes = [0; TOKEN_BYTES];
        getrandom::fill(&mut bytes)?;
        let own = [FOXGLOVE.to_owned()];
        Ok(Self {
            address,
            token: bytes.map(|byte| format!("{byte:02x}")).concat(),
            origins: own.iter().chain(origins).cloned().collect(),
        })
    }

    /// The URL to open in a viewer.
    pub(crate) fn url(&self) -> String {
        let Self { address, token, .. } = self;
        format!("ws://{address}/{token}")
    }

    /// Checks the request of a connection.
    ///
    /// # Errors
    ///
    /// The first check that failed.
    pub(crate) fn check(&self, headers: &HeaderMap, uri: &Uri) -> Result<(), Refused> {
        let text = |name| headers.get(name).map(|it| it.to_str().unwrap_or_default());
        if !text(header::HOST).is_some_and(|host| self.is_own(host)) {
            return Err(Refused::Host);
        }
        if !text(header::ORIGIN).is_none_or(|origin| self.allows(origin)) {
            return Err(Refused::Origin);
        }
        let path = uri.path();
        let token = path.strip_prefix('/').unwrap_or(path);
        let token = token.strip_suffix('/').unwrap_or(token);
        match self.is_token(token) {
            true => Ok(()),
            false => Err(Refused::Token),
        }
    }

    /// Whether a `Host` names this server. The port may be another one, that of a tunnel.
    fn is_own(&self, host: &str) -> bool {
        match host_of(host) {
            Some(Host::Address(ip)) => {
                self.address.ip().is_unspecified() || ip == self.address.ip()
            }
            Some(Host::Localhost) => true,
            Some(Host::Name) | None => false,
        }
    }

    /// Whether pages of an origin may connect: those of servers of this machine, and those that were named.
    fn allows(&self, origin: &str) -> bool {
        let local = origin.strip_prefix("http://").and_then(host_of);
        let is_local = match local {
            Some(Host::Address(ip)) => ip.is_loopback(),
            Some(Host::Localhost) => true,
            Some(Host::Name) | None => false,
        };
        is_local
            || self
                .origins
                .iter()
                .any(|it| it.eq_ignore_ascii_case(origin))
    }

    /// Compares in a time that does not depend on where a wrong token differs.
    fn is_token(&self, given: &str) -> bool {
        let ours = self.token.as_bytes();
        let differing = (given.bytes().zip(ours))
            .fold(0, |sum, (one, other)| hint::black_box(sum | (one ^ other)));
        given.len() == ours.len() && differing == 0
    }
}

/// The host of a `Host` or of an origin.
enum Host {
    Address(IpAddr),
    Localhost,
    /// Any other name.
    Name,
}

fn host_of(authority: &str) -> Option<Host> {
    let authority = authority.parse::<Authority>().ok()?;
    let host = authority.host();
    Some(match host.trim_matches(['[', ']']).parse() {
        Ok(ip) => Host::Address(ip),
        Err(_) if host.eq_ignore_ascii_case("localhost") => Host::Localhost,
        Err(_) => Host::Name,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn access() -> Access {
        let address = "127.0.0.1:8765".parse().unwrap();
        Access::new(address, &["https://studio.example".to_owned()]).unwrap()
    }

    fn check(access: &Access, host: &str, origin: Option<&str>, path: &str) -> Result<(), Refused> {
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, host.parse().unwrap());
        if let Some(origin) = origin {
            headers.insert(header::ORIGIN, origin.parse().unwrap());
        }
        access.check(&headers, &path.parse().unwrap())
    }

    #[test]
    fn the_token_is_the_path() {
        let access = access();
        let path = access
            .url()
            .strip_prefix("ws://127.0.0.1:8765")
            .unwrap()
            .to_owned();
        let of = |path: &str| check(&access, "127.0.0.1:8765", None, path);
        assert_eq!(of(&path), Ok(()));
        assert_eq!(of(&format!("{path}/")), Ok(()));
        assert_eq!(of("/"), Err(Refused::Token));
        assert_eq!(of(&path[..path.len() - 1]), Err(Refused::Token));
        assert_eq!(of(&format!("{path}0")), Err(Refused::Token));
        assert_eq!(of(&format!("{path}/x")), Err(Refused::Token));
        assert_ne!(path, access_path(), "each server has a token of its own");
    }

    fn access_path() -> String {
        let url = access().url();
        url.strip_prefix("ws://127.0.0.1:8765").unwrap().to_owned()
    }

    #[test]
    fn hosts_and_origins_are_checked() {
        let access = access();
        let path = format!("/{}", access.token);
        let of = |host, origin| check(&access, host, origin, &path);
        for host in [
            "127.0.0.1:8765",
            "localhost:8765",
            "localhost:9000",
            "LOCALHOST",
        ] {
            assert_eq!(of(host, None), Ok(()), "{host}");
        }
        for host in [
            "evil.example",
            "localhost.evil.example",
            "10.0.0.1:8765",
            "[::1]:8765",
            "",
        ] {
            assert_eq!(of(host, None), Err(Refused::Host), "{host}");
        }
        for origin in [
            "https://app.foxglove.dev",
            "https://studio.example",
            "http://localhost:8080",
            "http://127.0.0.1:3000",
            "http://[::1]:3000",
        ] {
            assert_eq!(of("localhost", Some(origin)), Ok(()), "{origin}");
        }
        for origin in [
            "https://evil.example",
            "http://app.foxglove.dev",
            "https://app.foxglove.dev.evil.example",
            "http://localhost.evil.example",
            "null",
            "",
        ] {
            let found = of("localhost", Some(origin));
            assert_eq!(found, Err(Refused::Origin), "{origin}");
        }
    }

    #[test]
    fn a_server_of_all_addresses_accepts_each_of_them() {
        let all = Access::new("0.0.0.0:8765".parse().unwrap(), &[]).unwrap();
        let path = format!("/{}", all.token);
        assert_eq!(check(&all, "10.0.0.1:8765", None, &path), Ok(()));
        assert_eq!(
            check(&all, "robot.example", None, &path),
            Err(Refused::Host)
        );
    }
}
