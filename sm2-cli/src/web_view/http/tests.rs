//! The server with clients that ask correctly, while others do not.

use std::{
    io::{Read as _, Write as _},
    net::{SocketAddr, TcpStream},
};

use sm2_test_support::{SOON, until};

use super::*;

/// A server without a domain: the tests make the samples.
struct Server {
    address: SocketAddr,
    path: String,
    site: Arc<Site>,
    requests: Requests,
    /// Serves until it is dropped.
    _runtime: Runtime,
}

impl Server {
    /// A server with timeouts that no client reaches.
    fn new() -> Self {
        Self::within(Timeouts {
            head: SOON,
            unread: SOON,
        })
    }

    fn within(timeouts: Timeouts) -> Self {
        let listener = net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let access = Access::new(address).unwrap();
        let path = access.url();
        let path = path.strip_prefix(&format!("http://{address}")).unwrap();
        let path = path.to_owned();
        let (site, requests) = Site::new(access).unwrap();
        let runtime = start(listener, Arc::clone(&site), timeouts).unwrap();
        Self {
            address,
            path,
            site,
            requests,
            _runtime: runtime,
        }
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).unwrap();
        stream.set_read_timeout(Some(SOON)).unwrap();
        stream
    }

    /// Sends a request with the token. Returns its connection.
    fn request(&self, method: &str, path: &str) -> TcpStream {
        let mut stream = self.connect();
        let (address, token) = (self.address, &self.path);
        let head = format!("{method} {token}{path} HTTP/1.1\r\nHost: {address}\r\n\r\n");
        stream.write_all(head.as_bytes()).unwrap();
        stream
    }

    fn ask(&self, method: &str, path: &str) -> String {
        rest(&mut self.request(method, path))
    }

    /// Opens a stream of events, and waits for its head.
    fn events(&self) -> TcpStream {
        let mut stream = self.request("GET", "api/events");
        let head = read_until(&mut stream, "\r\n\r\n");
        assert!(head.starts_with("HTTP/1.1 200 "), "{head}");
        stream
    }
}

fn rest(stream: &mut TcpStream) -> String {
    let mut answer = Vec::new();
    // The server may reset a connection that it closes early.
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8(answer).unwrap()
}

/// Reads up to this text.
fn read_until(stream: &mut TcpStream, end: &str) -> String {
    let mut read = Vec::new();
    while !read.ends_with(end.as_bytes()) {
        let mut byte = [0];
        stream.read_exact(&mut byte).unwrap();
        read.extend(byte);
    }
    String::from_utf8(read).unwrap()
}

#[test]
fn the_page_loads_nothing_from_elsewhere() {
    let server = Server::new();
    for (path, kind) in [
        ("", "text/html"),
        ("app.js", "text/javascript"),
        ("style.css", "text/css"),
    ] {
        let answer = server.ask("GET", path);
        assert!(answer.starts_with("HTTP/1.1 200 "), "{path}: {answer}");
        assert!(
            answer.contains(&format!("content-type: {kind}; charset=utf-8\r\n")),
            "{answer}"
        );
        for (name, value) in HEADERS {
            assert!(
                answer.contains(&format!("{name}: {value}\r\n")),
                "{path}: {name}"
            );
        }
    }
}

#[test]
fn only_known_requests_are_answered() {
    let server = Server::new();
    for (method, path, status) in [
        ("GET", "nothing", 404),
        ("GET", "../etc/passwd", 404),
        ("POST", "", 405),
        ("PUT", "api/domain", 405),
        ("OPTIONS", "api/domain", 405),
        ("GET", "api/why", 400),
        ("GET", "api/why?one=%3Cscript%3E", 400),
    ] {
        let answer = server.ask(method, path);
        assert!(
            answer.starts_with(&format!("HTTP/1.1 {status} ")),
            "{method} {path}: {answer}"
        );
    }
    let head = server.ask("HEAD", "app.js");
    assert!(
        head.starts_with("HTTP/1.1 200 ") && head.ends_with("\r\n\r\n"),
        "{head}"
    );
}

#[test]
fn requests_without_the_token_are_refused() {
    let mut server = Server::new();
    server.path = "/".into();
    for path in ["", "app.js", "api/domain", "api/events", "00/api/domain"] {
        let answer = server.ask("GET", path);
        assert!(answer.starts_with("HTTP/1.1 403 "), "{path}: {answer}");
        assert!(answer.contains("content-security-policy: "), "{answer}");
    }
    assert!(!server.site.has_clients());
}

#[test]
fn a_head_that_is_too_long_ends_the_connection() {
    let server = Server::new();
    let answer = server.ask("GET", &"a".repeat(2 * HEAD_BYTES));
    assert!(!answer.starts_with("HTTP/1.1 200 "), "{answer}");
    assert!(server.ask("GET", "").starts_with("HTTP/1.1 200 "));
}

#[test]
fn clients_that_send_no_head_keep_nobody_out() {
    let server = Server::within(Timeouts {
        head: Duration::from_millis(200),
        unread: SOON,
    });
    let silent: Vec<_> = (0..CONNECTIONS).map(|_| server.connect()).collect();
    assert!(server.ask("GET", "").starts_with("HTTP/1.1 200 "));
    for mut stream in silent {
        assert!(!rest(&mut stream).starts_with("HTTP/1.1 200 "));
    }
}

#[test]
fn the_number_of_streams_is_limited() {
    let server = Server::new();
    let mut streams: Vec<_> = (0..STREAMS).map(|_| server.events()).collect();
    assert!(server.ask("GET", "api/events").starts_with("HTTP/1.1 503 "));
    streams.pop();
    until("a stream is free", || {
        let mut stream = server.request("GET", "api/events");
        read_until(&mut stream, "\r\n\r\n").starts_with("HTTP/1.1 200 ")
    });
}

#[test]
fn a_request_for_a_sample_gets_the_next_one() {
    let server = Server::new();
    server.site.publish(br#"{"sample":1}"#);
    let mut stream = server.request("GET", "api/domain");
    until("a client waits", || server.site.has_clients());
    server.site.publish(br#"{"sample":2}"#);
    let answer = rest(&mut stream);
    assert!(answer.ends_with("\r\n\r\n{\"sample\":2}"), "{answer}");
    until("the client is gone", || !server.site.has_clients());
}

#[test]
fn a_client_that_reads_late_misses_samples_and_gets_the_newest() {
    const SAMPLES: usize = 1_000;
    let server = Server::new();
    let mut stream = server.events();
    let long = "x".repeat(64 << 10);
    for number in 1..=SAMPLES {
        server.site.publish(format!("{number}{long}").as_bytes());
    }
    let (mut events, mut read_bytes) = (Vec::<u8>::new(), 0);
    let last = format!("data: {SAMPLES}x");
    while !events.windows(last.len()).any(|it| it == last.as_bytes()) {
        let mut part = [0_u8; 8_192];
        let len = stream.read(&mut part).unwrap();
        assert_ne!(len, 0, "the stream ended");
        // A part of the text may be split over two reads.
        let keep = events.len().saturating_sub(last.len());
        events.drain(..keep);
        events.extend(&part[..len]);
        read_bytes += len;
    }
    assert!(
        read_bytes < SAMPLES * long.len() / 2,
        "{read_bytes} bytes came"
    );
}

#[test]
fn a_client_that_stops_reading_is_disconnected() {
    let server = Server::within(Timeouts {
        head: SOON,
        unread: Duration::from_millis(200),
    });
    let _stream = server.events();
    let sample = vec![b'x'; 1 << 20];
    until("the client is gone", || {
        server.site.publish(&sample);
        !server.site.has_clients()
    });
}

#[test]
fn a_question_wakes_the_sampling_thread_and_gets_its_answer() {
    let server = Server::new();
    let mut stream = server.request("GET", "api/why?one=talker:scan&other=listener:scan");
    let mut asked = None;
    until("the question comes", || {
        asked = server.requests.questions.try_recv().ok();
        asked.is_some()
    });
    assert_ne!((&server.requests.woken).read(&mut [0; 8]).unwrap(), 0);
    let Asked { question, answer } = asked.unwrap();
    let Question::Why { one, other } = question else {
        panic!("{question:?}");
    };
    assert_eq!(one.to_string(), "talker:scan");
    assert_eq!(other.unwrap().to_string(), "listener:scan");
    answer.send(Ok(vec!["a \"quote\"".into()])).unwrap();
    assert!(rest(&mut stream).ends_with("[\"a \\\"quote\\\"\"]"));
}
