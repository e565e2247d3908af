//! Two domains whose gateways are connected by QUIC on the local host.

use std::{
    io,
    net::{SocketAddr, ToSocketAddrs},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use crate::common::{ALL, Domain, report, runtime};
use sm2_gateway::{Config, Gateway};
use sm2_node::{CallError, ReplyError};
use sm2_test_support::{SOON, until};

#[test]
fn a_topic_of_one_domain_is_heard_in_another() {
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let runtime = runtime();
    let left = near.gateway(&runtime, &[(&far, None)], ALL);
    let right = far.gateway(&runtime, &[(&near, Some(left.address()))], ALL);
    let talker = near.node("talker");
    let publisher = talker.publisher::<str>("chatter").unwrap();
    let listener = far.node("listener");
    let subscriber = listener.subscriber::<str>("chatter").unwrap();
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    let long = "x".repeat(1 << 20);
    for (number, text) in ["hello", "", &long].into_iter().enumerate() {
        publisher.publish(text).unwrap();
        let sample = subscriber.recv_timeout(SOON).unwrap().expect("in time");
        assert!(*sample == *text, "message {number}");
        assert_eq!(sample.publisher().as_str(), "remote/near");
    }
    let peers = report(&runtime, &left).peers;
    assert_eq!(peers[0].messages.sent, 3);
    assert_eq!(peers[0].offered, ["topic chatter"]);
    let chatter = &peers[0].subjects[0];
    assert_eq!((&*chatter.kind, &*chatter.name), ("topic", "chatter"));
    assert_eq!((chatter.counts.offered, chatter.counts.sent), (3, 3));
    let peers = report(&runtime, &right).peers;
    assert_eq!(peers[0].subjects[0].counts.received, 3);
    assert_eq!((peers[0].messages.lost, peers[0].messages.skipped), (0, 0));
    // No datagram takes less than a microsecond.
    assert!(peers[0].rtt_ms.is_some_and(|it| it > 1e-3));
    drop(subscriber);
    // No subscriber is left, so the gateway unsubscribes too.
    until("unsubscribed", || {
        publisher.links().iter().all(|it| it.end.is_some())
    });
    runtime.block_on(async { tokio::join!(left.stop(), right.stop()) });
}

/// A gateway blocks no thread of its runtime.
#[test]
fn one_thread_is_enough_for_the_tasks_of_a_gateway() {
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let runtime = runtime();
    let left = near.gateway(&runtime, &[(&far, None)], ALL);
    let config = far.config(&[(&near, Some(left.address()))], ALL);
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let right = std::thread::spawn(move || {
        let builder = tokio::runtime::Builder::new_current_thread();
        let runtime = { builder }.enable_all().build().unwrap();
        runtime.block_on(async {
            let gateway = Gateway::start(&config).await.unwrap();
            stopped.await.unwrap();
            gateway.stop().await;
        });
    });
    let talker = near.node("talker");
    let publisher = talker.publisher::<str>("chatter").unwrap();
    let listener = far.node("listener");
    let subscriber = listener.subscriber::<str>("chatter").unwrap();
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    publisher.publish("hello").unwrap();
    let sample = subscriber.recv_timeout(SOON).unwrap().expect("in time");
    assert_eq!(*sample, *"hello");
    stop.send(()).unwrap();
    right.join().unwrap();
    runtime.block_on(left.stop());
}

/// A declaration can fail for a while, here because another node has the name of the gateway's node.
#[test]
fn an_interface_that_cannot_be_declared_is_declared_later() {
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let stranger = far.node("remote/near");
    let runtime = runtime();
    let left = near.gateway(&runtime, &[(&far, None)], ALL);
    let right = far.gateway(&runtime, &[(&near, Some(left.address()))], ALL);
    let talker = near.node("talker");
    let publisher = talker.publisher::<str>("chatter").unwrap();
    let listener = far.node("listener");
    let subscriber = listener.subscriber::<str>("chatter").unwrap();
    until("an offer", || {
        let peers = report(&runtime, &right).peers;
        peers.iter().any(|it| it.offers.len() == 1)
    });
    assert!(subscriber.links().is_empty());
    drop(stranger);
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    publisher.publish("hello").unwrap();
    let sample = subscriber.recv_timeout(SOON).unwrap().expect("in time");
    assert_eq!(*sample, *"hello");
    runtime.block_on(async { tokio::join!(left.stop(), right.stop()) });
}

/// A gateway never copies more than `message_bytes`, whether a node or a peer sends.
#[test]
fn a_message_that_is_too_long_is_refused_and_counted() {
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let runtime = runtime();
    let limits = format!("{ALL}[limits]\nmessage_bytes = 1000\n");
    let left = near.gateway(&runtime, &[(&far, None)], &limits);
    let right = far.gateway(&runtime, &[(&near, Some(left.address()))], ALL);
    let talker = near.node("talker");
    let map = talker.publisher_builder::<str>("map").latched(1);
    let publisher = map.declare().unwrap();
    let server = talker.server::<str, str>("echo").unwrap();
    let serving = std::thread::spawn(move || {
        let request = server.recv_timeout(SOON).unwrap().expect("in time");
        let reply = request.reply(&"x".repeat(2_000));
        assert!(matches!(
            reply,
            Err(ReplyError::TooLong { max_len: 1_024, .. })
        ));
        let request = server.recv_timeout(SOON).unwrap().expect("in time");
        request.reply(&"x".repeat(1_001)).unwrap();
        server
    });
    let listener = far.node("listener");
    let subscriber = listener.subscriber::<str>("map").unwrap();
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    // The gateway's subscription accepts 1,024 bytes: the publisher counts longer messages itself.
    let published = publisher.publish(&"x".repeat(1_025)).unwrap();
    assert_eq!((published.links, published.too_long), (0, 1));
    publisher.publish(&"x".repeat(1_001)).unwrap();
    let counts = || {
        let peers = report(&runtime, &left).peers;
        let mut subjects = peers.into_iter().flat_map(|it| it.subjects);
        let map = subjects.find(|it| it.name == "map");
        map.map(|it| (it.counts.refused, it.counts.offered))
    };
    // The next message must not supersede this one.
    until("refused", || counts() == Some((1, 0)));
    publisher.publish(&"x".repeat(1_000)).unwrap();
    let sample = subscriber.recv_timeout(SOON).unwrap().expect("in time");
    assert_eq!(sample.len(), 1_000);
    assert_eq!(counts(), Some((1, 1)));
    // A reply in this domain and a request from this domain have the same limit.
    let client = listener.client::<str, str>("echo").unwrap();
    client.wait_for_servers_timeout(1, SOON).unwrap();
    let error = client.call_timeout("", SOON).unwrap_err();
    let text = "the client accepts at most 1024";
    assert!(error.to_string().contains(text), "{error}");
    let error = client.call_timeout("", SOON).unwrap_err();
    let text = "longer than `message_bytes`";
    assert!(error.to_string().contains(text), "{error}");
    drop(serving.join().unwrap());
    let _server = listener.server::<str, str>("remote").unwrap();
    let client = talker.client::<str, str>("remote").unwrap();
    client.wait_for_servers_timeout(1, SOON).unwrap();
    let error = client.call_timeout(&"x".repeat(1_025), SOON).unwrap_err();
    assert!(matches!(error, CallError::TooLong { max_len: 1_024, .. }));
    let request = "x".repeat(1_001);
    let error = client.call_timeout(&request, SOON).unwrap_err();
    assert!(error.to_string().contains(text), "{error}");
    runtime.block_on(async { tokio::join!(left.stop(), right.stop()) });
}

#[test]
fn a_service_of_one_domain_is_called_in_another() {
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let runtime = runtime();
    let left = near.gateway(&runtime, &[(&far, None)], ALL);
    let right = far.gateway(&runtime, &[(&near, Some(left.address()))], ALL);
    let adder = near.node("adder");
    let server = adder.server::<[u64], u64>("sum").unwrap();
    let serving = std::thread::spawn(move || {
        while let Some(request) = server.recv_timeout(SOON).unwrap() {
            match request.len() {
                0 => return,
                1 => request.fail("one is not a sum").unwrap(),
                _ => {
                    let sum = request.iter().sum();
                    request.reply(&sum).unwrap();
                }
            }
        }
    });
    let asker = far.node("asker");
    let client = asker.client::<[u64], u64>("sum").unwrap();
    client.wait_for_servers_timeout(1, SOON).unwrap();
    assert_eq!(*client.call_timeout(&[1, 2, 3], SOON).unwrap(), 6);
    let many: Vec<u64> = (0..100_000).collect();
    assert_eq!(
        *client.call_timeout(&many, SOON).unwrap(),
        many.iter().sum::<u64>()
    );
    let error = client.call_timeout(&[1], SOON).unwrap_err();
    assert!(matches!(error, CallError::Failed { reason, .. } if reason == "one is not a sum"));
    // Three calls, each with a request and a reply; the last call failed.
    for (gateway, offered, received) in [(&left, 3, 3), (&right, 3, 3)] {
        until("counted", || {
            let peer = report(&runtime, gateway).peers.remove(0);
            let sum = peer.subjects.iter().find(|it| it.name == "sum");
            let sum = sum.filter(|it| it.kind == "service").map(|it| it.counts);
            let sum = sum.map(|it| (it.offered, it.sent, it.received));
            sum == Some((offered, offered, received))
        });
    }
    // A lost connection fails the call at once.
    runtime.block_on(left.stop());
    until("the server is gone", || {
        matches!(
            client.call_timeout(&[1, 2], SOON),
            Err(CallError::NoServer { .. }
                | CallError::ServerGone { .. }
                | CallError::Failed { .. })
        )
    });
    drop(asker);
    let local = near.node("local");
    let client = local.client::<[u64], u64>("sum").unwrap();
    client.wait_for_servers_timeout(1, SOON).unwrap();
    // The server ends, and with it the call.
    assert!(client.call_timeout(&[], SOON).is_err());
    serving.join().unwrap();
    runtime.block_on(right.stop());
}

//= SM2-GWR-003, SM2-GWR-004 test
#[test]
fn rules_that_change_take_effect_at_once() {
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let runtime = runtime();
    let left = near.gateway(&runtime, &[(&far, None)], ALL);
    let right = far.gateway(&runtime, &[(&near, Some(left.address()))], ALL);
    let talker = near.node("talker");
    let publisher = talker.publisher::<u64>("secret/count").unwrap();
    let listener = far.node("listener");
    // Has room for a message that comes although it is denied.
    let subscriber = (listener.subscriber_builder::<u64>("secret/count").depth(8))
        .declare()
        .unwrap();
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    let other = "[[rule]]\naction = \"deny\"\nnames = \"secret/*\"\n".to_owned() + ALL;
    let config = near.config(&[(&far, None)], &other);
    runtime.block_on(left.reload(&config));
    until("withdrawn", || {
        subscriber.links().iter().all(|it| it.end.is_some())
    });
    let peer = report(&runtime, &left).peers.remove(0);
    let denials = peer.denials.iter();
    let denials: Vec<_> = denials
        .map(|it| (&*it.name, &*it.direction, it.line))
        .collect();
    let line = std::fs::read_to_string(near.path("gateway.toml")).unwrap();
    let line = 1 + line.lines().position(|it| it == "[[rule]]").unwrap();
    assert_eq!(denials, [("secret/count", "out", Some(line))]);
    assert_eq!(peer.denied, 1);
    publisher.publish(&1).unwrap();
    // And the same in the other direction. The next message that comes is the one that is allowed again.
    let config = near.config(&[(&far, None)], ALL);
    runtime.block_on(left.reload(&config));
    subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
    // The link that ends may still be there, so a message may be lost.
    let mut sent = 1;
    until("a message of the link that is allowed again", || {
        sent += 1;
        publisher.publish(&sent).unwrap();
        let received = subscriber.recv_timeout(Duration::from_millis(10)).unwrap();
        received.is_some_and(|it| {
            assert!((2..=sent).contains(&*it), "{it:?}");
            true
        })
    });
    // The connection with a peer that is no longer trusted ends.
    let config = near.config(&[], ALL);
    runtime.block_on(left.reload(&config));
    until("gone", || report(&runtime, &left).peers.is_empty());
    assert!(report(&runtime, &left).absent.is_empty());
    until("gone at the other side", || {
        report(&runtime, &right).absent == ["near"]
    });
    runtime.block_on(async { tokio::join!(left.stop(), right.stop()) });
}

/// A latched message is published once, before any subscriber exists.
//= SM2-GWM-009 test
#[test]
fn what_is_latched_reaches_subscribers_that_come_later() {
    let [a, b, c] = ["a", "b", "c"].map(Domain::new);
    let runtime = runtime();
    let first = a.gateway(&runtime, &[(&b, None), (&c, None)], ALL);
    let second = b.gateway(&runtime, &[(&a, Some(first.address()))], ALL);
    let third = c.gateway(&runtime, &[(&a, Some(first.address()))], ALL);
    let mapper = a.node("mapper");
    let maps = (mapper.publisher_builder::<u64>("map").latched(1))
        .declare()
        .unwrap();
    maps.publish(&7).unwrap();
    // A node makes progress only while its functions are called.
    let is_over = Arc::new(AtomicBool::new(false));
    let until_over = Arc::clone(&is_over);
    let moving = std::thread::spawn(move || {
        while !until_over.load(Ordering::Relaxed) {
            // Waits for more subscribers than there will ever be.
            let _ = maps.wait_for_subscribers_timeout(100, Duration::from_millis(5));
        }
    });
    let mut kept = Vec::new();
    for (domain, name) in [(&b, "early"), (&b, "late"), (&c, "elsewhere")] {
        let node = domain.node(name);
        let subscriber = node.subscriber::<u64>("map").unwrap();
        let sample = subscriber.recv_timeout(SOON).unwrap().expect(name);
        assert_eq!(*sample, 7, "{name}");
        kept.push((node, subscriber));
    }
    is_over.store(true, Ordering::Relaxed);
    moving.join().unwrap();
    runtime.block_on(async { tokio::join!(first.stop(), second.stop(), third.stop()) });
}

#[test]
fn three_domains_in_a_row_pass_on_and_give_nothing_back() {
    let [a, b, c] = ["a", "b", "c"].map(Domain::new);
    let runtime = runtime();
    let first = a.gateway(&runtime, &[(&b, None)], ALL);
    let second = b.gateway(&runtime, &[(&a, Some(first.address())), (&c, None)], ALL);
    let third = c.gateway(&runtime, &[(&b, Some(second.address()))], ALL);
    let nodes = [(&a, "talker"), (&a, "here"), (&b, "between"), (&c, "there")];
    let [talker, here, between, there] = nodes.map(|(domain, name)| domain.node(name));
    let publisher = talker.publisher::<u64>("count").unwrap();
    let subscribers = [&here, &between, &there].map(|node| {
        let builder = node.subscriber_builder::<u64>("count").depth(256);
        builder.declare().unwrap()
    });
    // A node makes progress only while its functions are called.
    let moment = Duration::from_millis(1);
    until("linked", || {
        publisher.links();
        let linked =
            |it: &&sm2_node::Subscriber<u64>| it.wait_for_publishers_timeout(1, moment).is_ok();
        subscribers.iter().filter(linked).count() == subscribers.len()
    });
    // The subscriber in its own domain, and the gateway.
    publisher.wait_for_subscribers_timeout(2, SOON).unwrap();
    // The last number that each has received.
    let mut last = [0; 3];
    let mut number = 0;
    until("all the way", || {
        number += 1;
        publisher.publish(&number).unwrap();
        let sample = subscribers[2].recv_timeout(Duration::from_millis(50));
        last[2] = sample.unwrap().map_or(0, |it| *it);
        last[2] > 0
    });
    // Each round goes all the way, so what a gateway gives back of one round comes in one of the next.
    for _ in 0..20 {
        number += 1;
        publisher.publish(&number).unwrap();
        for (subscriber, last) in subscribers.iter().zip(&mut last) {
            while *last < number {
                let sample = subscriber.recv_timeout(SOON).unwrap().expect("in time");
                assert!(*sample > *last, "{} after {last}", *sample);
                *last = *sample;
            }
        }
    }
    runtime.block_on(async { tokio::join!(first.stop(), second.stop(), third.stop()) });
}

/// Asks the system, except for a name that it would look up in the DNS.
fn look_up(host: &str) -> io::Result<Vec<SocketAddr>> {
    match host.split_once(':') {
        Some(("none.invalid", _)) => Err(io::Error::other("no such host")),
        _ => host.to_socket_addrs().map(Iterator::collect),
    }
}

#[test]
fn a_peer_is_found_by_the_name_of_its_host() {
    let [near, four, six] = ["near", "four", "six"].map(Domain::new);
    let runtime = runtime();
    let left = near.gateway(&runtime, &[(&four, None), (&six, None)], ALL);
    let port = left.address().port();
    for (far, listen) in [(&four, "127.0.0.1:0"), (&six, "[::]:0")] {
        far.config(&[(&near, Some(left.address()))], ALL);
        let path = far.path("gateway.toml");
        let text = std::fs::read_to_string(&path).unwrap();
        // A name that does not resolve must not prevent the other addresses from being tried.
        let hosts = format!("none.invalid:{port}\", \"localhost:{port}");
        let text = text.replace(&left.address().to_string(), &hosts);
        let text = text.replace("127.0.0.1:0", listen);
        let mut config = Config::parse(&path, &text).unwrap();
        config.look_up = look_up;
        let right = runtime.block_on(Gateway::start(&config)).unwrap();
        until("connected", || !report(&runtime, &right).peers.is_empty());
        runtime.block_on(right.stop());
    }
    runtime.block_on(left.stop());
}
