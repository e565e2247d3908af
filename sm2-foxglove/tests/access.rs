//! Only viewers that know the URL may connect.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;

use sm2_foxglove::{Options, Server, ServerError};
use sm2_test_support::{SOON, until};
use tungstenite::Error;
use tungstenite::http::header::{HOST, HeaderName, ORIGIN, SEC_WEBSOCKET_PROTOCOL};

use crate::common::{Viewer, World, address, request};

/// The status and the text that refuse a request; `None` if it is accepted.
fn refused(url: &str, headers: &[(HeaderName, &str)]) -> Option<(u16, String)> {
    let tcp = TcpStream::connect(address(url)).unwrap();
    tcp.set_read_timeout(Some(SOON)).unwrap();
    match tungstenite::client(request(url, headers), tcp) {
        Ok(_) => None,
        Err(tungstenite::HandshakeError::Failure(Error::Http(response))) => {
            let body = response.body().clone().unwrap_or_default();
            Some((response.status().as_u16(), String::from_utf8(body).unwrap()))
        }
        Err(other) => panic!("{other}"),
    }
}

#[test]
fn only_the_printed_url_is_accepted() {
    let world = World::new();
    let foxglove = world.foxglove(Options::default());
    let url = &foxglove.url;
    assert_eq!(refused(url, &[]), None);
    let (without, token) = url.rsplit_once('/').unwrap();
    assert_eq!(token.len(), 32);
    for wrong in [
        format!("{without}/"),
        format!("{without}/{}", "0".repeat(32)),
    ] {
        let (status, text) = refused(&wrong, &[]).unwrap();
        assert_eq!(status, 403);
        assert!(
            text.contains("use the URL that sm2-foxglove has printed"),
            "{text}"
        );
    }
    let (status, text) = refused(url, &[(HOST, "evil.example")]).unwrap();
    assert_eq!(status, 403);
    assert!(text.contains("Host"), "{text}");
    let (status, text) = refused(url, &[(ORIGIN, "https://evil.example")]).unwrap();
    assert_eq!(status, 403);
    assert!(text.contains("--allow-origin"), "{text}");
    let (status, text) = refused(url, &[(SEC_WEBSOCKET_PROTOCOL, "mqtt")]).unwrap();
    assert_eq!(status, 400);
    assert!(text.contains("foxglove.sdk.v1"), "{text}");
}

#[test]
fn pages_of_foxglove_and_of_this_machine_may_connect() {
    let world = World::new();
    let foxglove = world.foxglove(Options {
        allow_origins: vec!["https://studio.example".to_owned()],
        ..Options::default()
    });
    let url = &foxglove.url;
    for origin in [
        "https://app.foxglove.dev",
        "http://localhost:8080",
        "https://studio.example",
    ] {
        assert_eq!(refused(url, &[(ORIGIN, origin)]), None, "{origin}");
    }
    // The subprotocol of viewers that do not know the newer one.
    let older = [(SEC_WEBSOCKET_PROTOCOL, "x, foxglove.websocket.v1")];
    assert_eq!(refused(url, &older), None);
}

#[test]
fn no_http_is_no_viewer() {
    let world = World::new();
    let foxglove = world.foxglove(Options::default());
    let mut tcp = TcpStream::connect(address(&foxglove.url)).unwrap();
    tcp.set_read_timeout(Some(SOON)).unwrap();
    tcp.write_all(b"\0\x01\x02 no HTTP\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    // The server closes the connection, and still serves others.
    let _ = tcp.read_to_end(&mut answer);
    assert!(answer.is_empty(), "{answer:?}");
    Viewer::connect(&foxglove.url);
}

#[test]
fn a_taken_port_is_an_error() {
    let world = World::new();
    let foxglove = world.foxglove(Options::default());
    let options = Options {
        listen: address(&foxglove.url).parse().unwrap(),
        ..Options::default()
    };
    let node = world.node("other");
    let error = Server::start(&node, options).err().unwrap();
    assert!(matches!(error, ServerError::Listen { .. }), "{error}");
    assert!(
        error.to_string().contains("another port may be free"),
        "{error}"
    );
}

#[test]
fn the_number_of_viewers_is_limited() {
    let world = World::new();
    let foxglove = world.foxglove(Options::default());
    let mut viewers: Vec<_> = (0..32).map(|_| Viewer::connect(&foxglove.url)).collect();
    let is_accepted = || {
        let tcp = TcpStream::connect(address(&foxglove.url)).unwrap();
        tcp.set_read_timeout(Some(SOON)).unwrap();
        tungstenite::client(request(&foxglove.url, &[]), tcp).is_ok()
    };
    assert!(!is_accepted());
    drop(viewers.pop());
    until("a viewer has made room", is_accepted);
}

#[test]
fn the_end_of_the_server_closes_the_connections() {
    let world = World::new();
    let mut foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    // A client that never sends its request does not delay the end.
    let _silent = TcpStream::connect(address(&foxglove.url)).unwrap();
    foxglove.end();
    let close = loop {
        if let tungstenite::Message::Close(close) = viewer.frame().unwrap() {
            break close.unwrap();
        }
    };
    assert_eq!(u16::from(close.code), 1001);
}
