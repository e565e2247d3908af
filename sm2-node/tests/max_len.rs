//! Messages that are longer than their receiver accepts.

use std::time::Duration;

use crate::common::{Domain, Endpoint, SOON, meet, next, pattern, until};
use sm2_node::{
    CallError, Client, PublishError, Published, Publisher, ReplyError, Server, Subscriber,
};
use sm2_proto::link::Counters;

/// The maximum of a short subscriber, server or client.
const MAX: usize = 8_192;

#[derive(Clone, Copy, Debug)]
enum Form {
    Ring,
    Pooled,
    Sealed,
}

const FORMS: [Form; 3] = [Form::Ring, Form::Pooled, Form::Sealed];

/// A publisher with a reliable and a best-effort subscriber of `MAX` bytes, and one that accepts more.
struct Scene {
    publisher: Publisher<[u8]>,
    short: [Subscriber<[u8]>; 2],
    long: Subscriber<[u8]>,
}

impl Scene {
    fn new(domain: &Domain, form: Form) -> Self {
        let node = |name| domain.node_on(matches!(form, Form::Ring), name);
        let builder = node("talker").publisher_builder::<[u8]>("topic");
        let publisher = builder
            .sealed(matches!(form, Form::Sealed))
            .reliable(true)
            // If a publication waited, the test would time out.
            .publish_timeout(Duration::MAX)
            .declare()
            .unwrap();
        let short = [("reliable", true), ("best-effort", false)].map(|(name, reliable)| {
            let builder = node(name).subscriber_builder("topic").reliable(reliable);
            builder.depth(1).max_len(MAX as u64).declare().unwrap()
        });
        let long = node("long").subscriber("topic").unwrap();
        meet(&publisher, &[&short[0], &short[1], &long]);
        Self {
            publisher,
            short,
            long,
        }
    }
}

fn counters(publisher: &Publisher<[u8]>, name: &str) -> Counters {
    let links = publisher.links();
    let link = links.iter().find(|link| link.peer.name.as_str() == name);
    link.expect("a link").counters
}

//= SM2-QOS-008, SM2-PAY-010 test
#[test]
fn a_message_that_is_too_long_skips_its_links_alone() {
    for form in FORMS {
        let domain = Domain::new();
        let scene = Scene::new(&domain, form);
        let exact = pattern(MAX, 1);
        let all = Published {
            links: 3,
            missed: 0,
            too_long: 0,
        };
        assert_eq!(scene.publisher.publish(&exact).unwrap(), all, "{form:?}");
        // The reliable subscriber has no room now, so a publication for it would wait.
        let long = pattern(MAX + 1, 2);
        let one = Published {
            links: 1,
            missed: 1,
            too_long: 2,
        };
        assert_eq!(scene.publisher.publish(&long).unwrap(), one, "{form:?}");
        let error = one.complete().unwrap_err();
        assert!(matches!(error, PublishError::TooLong { .. }), "{error}");
        assert!(error.to_string().contains("raise max_len"), "{error}");
        assert!(*next(&scene.long) == *exact);
        assert!(*next(&scene.long) == *long);
        for subscriber in &scene.short {
            assert!(*next(subscriber) == *exact);
            assert!(subscriber.try_recv().unwrap().is_none());
        }
        until(|| scene.publisher.counters().in_flight == 0);
        for name in ["reliable", "best-effort"] {
            let expected = Counters {
                offered: 2,
                delivered: 1,
                too_long: 1,
                ..Counters::default()
            };
            assert_eq!(counters(&scene.publisher, name), expected, "{form:?}");
        }
        // The links go on.
        assert_eq!(scene.publisher.publish(&exact).unwrap(), all, "{form:?}");
        for subscriber in scene.short.iter().chain([&scene.long]) {
            assert!(*next(subscriber) == *exact);
        }
    }
}

//= SM2-QOS-008 test
#[test]
fn loans_and_runs_of_messages_say_what_was_too_long() {
    for form in FORMS {
        let domain = Domain::new();
        let scene = Scene::new(&domain, form);
        let loan = scene.publisher.loan_slice(MAX + 1).unwrap();
        let published = loan.publish().unwrap();
        assert_eq!((published.links, published.too_long), (1, 2), "{form:?}");
        let run = [MAX + 1, 100, MAX + 1].map(|len| pattern(len, 3));
        let sum = scene
            .publisher
            .publish_all(run.iter().map(|it| &**it))
            .unwrap();
        assert_eq!((sum.links, sum.missed, sum.too_long), (1, 2, 4), "{form:?}");
        assert_eq!(counters(&scene.publisher, "reliable").too_long, 3);
    }
}

/// A publisher takes no memory for a message that no subscriber accepts.
//= SM2-QOS-008 test
#[test]
fn a_message_that_nobody_accepts_takes_no_memory() {
    for form in FORMS {
        let domain = Domain::new();
        let Scene {
            publisher,
            short,
            long,
        } = Scene::new(&domain, form);
        drop(long);
        until(|| publisher.links().iter().filter(|link| link.open).count() == 2);
        let published = publisher.publish(&pattern(100_000, 1)).unwrap();
        let none = Published {
            links: 0,
            missed: 1,
            too_long: 2,
        };
        assert_eq!((published, publisher.pool_bytes()), (none, 0), "{form:?}");
        drop(short);
    }
}

//= SM2-QOS-005, SM2-QOS-008 test
#[test]
fn latched_messages_that_are_too_long_are_left_out() {
    for form in FORMS {
        let domain = Domain::new();
        let node = |name| domain.node_on(matches!(form, Form::Ring), name);
        let builder = node("talker").publisher_builder::<[u8]>("topic");
        let publisher = builder
            .latched(3)
            .reliable(true)
            .sealed(matches!(form, Form::Sealed))
            .declare()
            .unwrap();
        for (seed, len) in (1..).zip([MAX, MAX + 1, MAX]) {
            publisher.publish(&pattern(len, seed)).unwrap();
        }
        let builder = node("listener").subscriber_builder::<[u8]>("topic");
        let builder = builder.reliable(true).depth(1).max_borrowed(1);
        let subscriber = builder.max_len(MAX as u64).declare().unwrap();
        meet(&publisher, &[&subscriber]);
        for seed in [1, 3] {
            let mut taken = None;
            until(|| {
                // Drives the node of the publisher.
                publisher.links();
                taken = subscriber.try_recv().unwrap();
                taken.is_some()
            });
            assert!(*taken.unwrap() == *pattern(MAX, seed), "{form:?} {seed}");
        }
        let it = counters(&publisher, "listener");
        assert_eq!((it.offered, it.too_long), (3, 1), "{form:?}");
    }
}

type Echo = (Server<[u8], [u8]>, Client<[u8], [u8]>);

/// A server and a client, with these maximums.
fn service(domain: &Domain, form: Form, [server, client]: [u64; 2]) -> Echo {
    let node = |name| domain.node_on(matches!(form, Form::Ring), name);
    let sealed = matches!(form, Form::Sealed);
    let builder = node("server").server_builder("echo").sealed(sealed);
    let server = builder.max_len(server).declare().unwrap();
    let builder = node("client").client_builder("echo").sealed(sealed);
    let client = builder.max_len(client).declare().unwrap();
    let step = Duration::from_millis(1);
    while client.wait_for_servers_timeout(1, step).is_err() {
        assert!(server.try_recv().unwrap().is_none(), "no call was made");
    }
    (server, client)
}

//= SM2-SRV-006 test
#[test]
fn a_request_that_is_too_long_fails_at_once() {
    for form in FORMS {
        let domain = Domain::new();
        let (server, client) = service(&domain, form, [MAX as u64, 1 << 30]);
        // Without a deadline: the error does not wait for one.
        let error = client.call(&pattern(MAX + 1, 1)).unwrap_err();
        let CallError::TooLong { len, max_len, .. } = error else {
            panic!("{form:?}: {error}");
        };
        assert_eq!((len, max_len), (MAX as u64 + 1, MAX as u64));
        let exact = pattern(MAX, 2);
        let mut call = client.send(&exact).unwrap();
        let request = server.recv_timeout(SOON).unwrap().unwrap();
        assert!(*request == *exact, "{form:?}");
        request.reply(&[]).unwrap();
        until(|| call.try_wait().unwrap().is_some());
    }
}

//= SM2-SRV-005, SM2-SRV-006 test
#[test]
fn a_request_goes_to_a_server_that_accepts_its_length() {
    let domain = Domain::new();
    let servers: Vec<Server<[u8], [u8]>> = [("short", MAX), ("long", 2 * MAX)]
        .map(|(name, max)| {
            let builder = domain.node(name).server_builder("echo");
            builder.max_len(max as u64).declare().unwrap()
        })
        .into();
    let client: Client<[u8], [u8]> = domain.node("client").client("echo").unwrap();
    let step = Duration::from_millis(1);
    while client.wait_for_servers_timeout(2, step).is_err() {
        for server in &servers {
            assert!(server.try_recv().unwrap().is_none(), "no call was made");
        }
    }
    // The server with the fewest calls would be the short one for each second call.
    let calls: Vec<_> = (0..4)
        .map(|seed| client.send(&pattern(MAX + 1, seed)).unwrap())
        .collect();
    for seed in 0..4 {
        let request = servers[1].recv_timeout(SOON).unwrap().unwrap();
        assert!(*request == *pattern(MAX + 1, seed));
        request.reply(&[]).unwrap();
    }
    assert!(servers[0].try_recv().unwrap().is_none());
    let error = client.send(&pattern(2 * MAX + 1, 1)).unwrap_err();
    let longest = 2 * MAX as u64;
    assert!(
        matches!(error, CallError::TooLong { max_len, .. } if max_len == longest),
        "{error}"
    );
    drop(calls);
}

//= SM2-SRV-007 test
#[test]
fn a_reply_that_is_too_long_is_an_error_at_both_ends() {
    for form in FORMS {
        let domain = Domain::new();
        let (server, client) = service(&domain, form, [1 << 30, MAX as u64]);
        for (len, fails) in [(MAX + 1, true), (MAX, false), (MAX + 1, true)] {
            let reply = pattern(len, 1);
            // A text may be as long as the client accepts, too.
            let reason = "x".repeat(len);
            for is_failure in [false, true] {
                let mut call = client.send(b"please").unwrap();
                let request = server.recv_timeout(SOON).unwrap().unwrap();
                let sent = match is_failure {
                    false => request.reply(&reply),
                    true => request.fail(&reason),
                };
                let mut outcome = Ok(None);
                until(|| {
                    outcome = call.try_wait();
                    !matches!(outcome, Ok(None))
                });
                let expected = match (fails, is_failure) {
                    (true, _) => "the reply has 8193 bytes, but the client accepts at most 8192",
                    (false, true) => reason.as_str(),
                    (false, false) => {
                        sent.unwrap();
                        assert!(*outcome.unwrap().unwrap() == *reply, "{form:?}");
                        continue;
                    }
                };
                match sent {
                    Err(ReplyError::TooLong { max_len, .. }) => {
                        assert!(fails && max_len == MAX as u64);
                    }
                    other => assert!(other.is_ok() && !fails, "{form:?}"),
                }
                let Err(CallError::Failed { reason, .. }) = outcome else {
                    panic!("{form:?} {len}");
                };
                assert_eq!(reason, expected, "{form:?} {len}");
            }
        }
    }
}

/// The default accepts what programs send, and its bound is exact: see `hostile.rs` for longer messages.
#[test]
fn the_default_accepts_long_messages() {
    let domain = Domain::new();
    let publisher = domain.node("talker").publisher::<[u8]>("topic").unwrap();
    let subscriber = domain.node("listener").subscriber::<[u8]>("topic").unwrap();
    meet(&publisher, &[&subscriber]);
    let ends: [&dyn Endpoint; 2] = [&publisher, &subscriber];
    let loan = publisher.loan_slice(100_000_000).unwrap();
    let published = loan.publish().unwrap();
    assert_eq!((published.links, published.too_long), (1, 0));
    assert_eq!(next(&subscriber).len(), 100_000_000);
    assert!(ends.iter().all(|end| end.links()[0].open));
}
