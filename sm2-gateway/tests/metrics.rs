//! Metrics over HTTP, for clients that ask correctly while others do not.

use crate::common;
use std::{
    io::{ErrorKind, Read, Write},
    net::{SocketAddr, TcpStream},
    time::Duration,
};

use crate::common::{ALL, Domain, runtime};
use sm2_gateway::{Gateway, metrics::Timeouts};
use sm2_test_support::{SOON, until};
use tokio::{net::TcpListener, runtime::Runtime};

/// Timeouts that no honest scraper reaches.
const PATIENT: Timeouts = Timeouts {
    connection: SOON,
    head: SOON,
    report: SOON,
};

fn serve(runtime: &Runtime, gateway: &Gateway, timeouts: Timeouts) -> SocketAddr {
    let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).unwrap();
    let address = listener.local_addr().unwrap();
    let _inside = runtime.enter();
    gateway.serve_metrics_within(listener, timeouts);
    address
}

fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(SOON)).unwrap();
    stream
}

fn ask(address: SocketAddr, request: &str) -> String {
    let mut stream = connect(address);
    let text = format!("{request} HTTP/1.1\r\nHost: here\r\n\r\n");
    let _ = stream.write_all(text.as_bytes());
    let mut answer = Vec::new();
    // The server may reset a connection that it closes early.
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8(answer).unwrap()
}

fn scrape(address: SocketAddr) -> String {
    ask(address, "GET /metrics")
}

#[test]
fn what_goes_to_a_peer_is_counted_for_prometheus() {
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let runtime = runtime();
    let left = near.gateway(&runtime, &[(&far, None)], ALL);
    let address = serve(&runtime, &left, PATIENT);
    let gauge = |text: &str, value| {
        let line = format!("sm2_gateway_peer_connected{{gateway=\"near\",peer=\"far\"}} {value}");
        text.lines().any(|it| it == line)
    };
    assert!(gauge(&scrape(address), 0));
    let right = far.gateway(&runtime, &[(&near, Some(left.address()))], ALL);
    let talker = near.node("talker");
    let publisher = talker.publisher::<u64>("count").unwrap();
    let listener = far.node("listener");
    let subscriber = listener.subscriber::<u64>("count").unwrap();
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    publisher.publish(&1).unwrap();
    subscriber.recv_timeout(SOON).unwrap().expect("in time");
    let sent =
        "sm2_gateway_sent_total{gateway=\"near\",peer=\"far\",kind=\"topic\",name=\"count\"} 1";
    until("counted", || scrape(address).lines().any(|it| it == sent));
    let text = scrape(address);
    assert!(gauge(&text, 1), "{text}");
    assert!(text.starts_with("HTTP/1.1 200 "), "{text}");
    let kind = "content-type: application/openmetrics-text; version=1.0.0; charset=utf-8";
    assert!(text.lines().any(|it| it == kind), "{text}");
    assert!(text.ends_with("# EOF\n"), "{text}");
    assert!(ask(address, "GET /").starts_with("HTTP/1.1 404 "));
    assert!(ask(address, "POST /metrics").starts_with("HTTP/1.1 405 "));
    runtime.block_on(async { tokio::join!(left.stop(), right.stop()) });
}

/// Returns true if the other side has closed the connection, whatever it sent before.
fn is_over(stream: &mut TcpStream) -> bool {
    let mut bytes = [0; 4096];
    loop {
        match stream.read(&mut bytes) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(error) => return error.kind() == ErrorKind::ConnectionReset,
        }
    }
}

/// The time for the head of a request; three such times pass.
const HEAD: Duration = Duration::from_millis(if cfg!(feature = "slow") { 2_000 } else { 200 });

/// Scrapes until there is an answer: on a busy machine, an honest scraper can need more time than [`HEAD`].
fn scrape_in_the_end(address: SocketAddr) -> String {
    let mut text = String::new();
    until("a scrape", || {
        text = scrape(address);
        text.starts_with("HTTP/1.1 200 ")
    });
    text
}

#[test]
fn scrapers_that_are_slow_or_hostile_harm_nothing() {
    let near = Domain::new("near");
    let runtime = runtime();
    let gateway = near.gateway(&runtime, &[], ALL);
    let timeouts = Timeouts {
        head: HEAD,
        ..PATIENT
    };
    let address = serve(&runtime, &gateway, timeouts);
    // More connections than the server has room for: some send nothing, some never finish, one
    // request is too long.
    let mut silent: Vec<TcpStream> = (0..20).map(|_| connect(address)).collect();
    for stream in silent.iter_mut().step_by(2) {
        stream.write_all(b"GET /metrics HTTP/1.1\r\nX: ").unwrap();
    }
    // Meanwhile the gateway itself keeps working.
    assert!(common::report(&runtime, &gateway).peers.is_empty());
    // Each connection times out, and then makes room for another.
    scrape_in_the_end(address);
    for stream in &mut silent {
        assert!(is_over(stream));
    }
    let mut long = connect(address);
    let head = vec![b'x'; 1 << 20];
    // The server may close the connection before all bytes are written.
    let _ = long.write_all(b"GET /metrics HTTP/1.1\r\nX: ");
    let _ = long.write_all(&head);
    assert!(is_over(&mut long));
    assert!(scrape_in_the_end(address).ends_with("# EOF\n"));
    runtime.block_on(gateway.stop());
}
