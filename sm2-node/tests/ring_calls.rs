//! Calls on both lanes as programs see them: the lane in use, wake-ups, and exactly one end for each call.
//! (`services.rs` has the tests that do not depend on lanes.)

use std::os::fd::AsFd;
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use crate::common::{Domain, LANES, SOON, WAYS, next_request, pattern, until};
use sm2_io::wait_readable;
use sm2_node::asynchronous::IntoAsync;
use sm2_node::diagnostics::LinkStatus;
use sm2_node::{CallError, Client, ClientBuilder, Reply, Request, Server, ServerBuilder};

/// The calls of a test that looks for a lost wake-up.
const CALLS: u64 = if cfg!(feature = "slow") { 300 } else { 30 };

fn serving(domain: &Domain, ring: bool) -> ServerBuilder<[u8], [u8]> {
    domain.node_on(ring, "server").server_builder("service")
}

fn calling(domain: &Domain, ring: bool) -> ClientBuilder<[u8], [u8]> {
    domain.node_on(ring, "client").client_builder("service")
}

/// Both ends of a link.
type Ends = (Server<[u8], [u8]>, Client<[u8], [u8]>);

/// Returns both ends, linked: each is called in turn until the link is open at both ends.
fn linked(server: ServerBuilder<[u8], [u8]>, client: ClientBuilder<[u8], [u8]>) -> Ends {
    let (server, client) = (server.declare().unwrap(), client.declare().unwrap());
    let moment = Duration::from_millis(1);
    until(|| {
        let open = client.wait_for_servers_timeout(1, moment).is_ok();
        server.wait_for_clients_timeout(1, moment).is_ok() && open
    });
    (server, client)
}

fn ring(links: &[LinkStatus]) -> bool {
    let [link] = links else {
        panic!("{links:?}");
    };
    link.ring
}

/// Pauses for a duration that differs from round to round.
fn dawdle(round: u64) {
    let spins = [0, 10, 100, 1_000, 10_000][(round % 5) as usize];
    (0..spins * (1 + round % 3)).for_each(|_| std::hint::spin_loop());
}

/// Returns a message that depends on the number: some fit into a cell of the ring, and others need a slot.
fn message(number: u64) -> Vec<u8> {
    pattern([8, 128][number as usize % 2], number)
}

/// Replies with the request's bytes, until it gets an empty request.
fn echo(server: Server<[u8], [u8]>, mut next: impl FnMut() + Send + 'static) -> JoinHandle<u64> {
    thread::spawn(move || {
        for served in 0.. {
            next();
            let request = server.recv().unwrap();
            let bytes = request.to_vec();
            request.reply(&bytes).unwrap();
            if bytes.is_empty() {
                return served;
            }
        }
        0
    })
}

/// A message in a segment of its own.
const LONGEST: usize = if cfg!(feature = "slow") {
    3 << 20
} else {
    1 << 20
};

//= SM2-RNG-001, SM2-RNG-002 test
#[test]
fn the_ring_lane_is_used_if_both_offer_it_and_nothing_has_to_be_sealed() {
    let sizes = [0, 1, 104, 105, 4_032, 4_033, 4_096, 4_097, 61_441, LONGEST];
    for (ours, theirs) in [(true, true), (true, false), (false, true), (false, false)] {
        for sealed in [false, true] {
            let domain = Domain::new();
            let client = calling(&domain, ours).sealed(sealed);
            let (server, client) = linked(serving(&domain, theirs), client);
            let expected = ours && theirs && !sealed;
            assert_eq!(ring(&client.links()), expected);
            assert_eq!(ring(&server.links()), expected);
            for (seed, len) in (1..).zip(sizes) {
                let bytes = pattern(len, seed);
                let call = client.send_timeout(&bytes, SOON).unwrap();
                let request = next_request(&server);
                assert!(*request == *bytes, "{len} bytes");
                let turned: Vec<u8> = request.iter().rev().copied().collect();
                request.reply(&turned).unwrap();
                assert!(*call.wait().unwrap() == *turned, "{len} bytes");
            }
            let failing = client.send_timeout(b"x", SOON).unwrap();
            next_request(&server).fail("not today").unwrap();
            let error = failing.wait().unwrap_err();
            assert!(matches!(error, CallError::Failed { reason, .. } if reason == "not today"));
            for links in [client.links(), server.links()] {
                let counters = links[0].counters;
                assert_eq!((counters.offered, links[0].received.messages), (11, 11));
            }
        }
    }
}

//= SM2-RNG-012 test
#[test]
fn each_way_of_waiting_gets_its_requests_and_its_replies() {
    const ROUNDS: u64 = CALLS;
    for lane in LANES {
        for (ours, theirs) in WAYS.into_iter().flat_map(|a| WAYS.map(|b| (a, b))) {
            let domain = Domain::new();
            let server = serving(&domain, lane).wait(theirs);
            let (server, client) = linked(server, calling(&domain, lane).wait(ours));
            let mut round = 0;
            let server = echo(server, move || {
                round += 1;
                dawdle(round);
            });
            for number in 1..=ROUNDS {
                let reply = client.call_timeout(&message(number), SOON).unwrap();
                assert_eq!(*reply, message(number));
                dawdle(number / 2);
            }
            client.call_timeout(&[], SOON).unwrap();
            assert_eq!(server.join().unwrap(), ROUNDS);
        }
    }
}

/// A program polls the descriptor whenever it finds nothing: each request, and each reply, must make it
/// readable.
//= SM2-RNG-012 test
#[test]
fn polled_descriptors_are_readable_for_every_request_and_reply() {
    const ROUNDS: u64 = if cfg!(feature = "slow") { 500 } else { 100 };
    for lane in LANES {
        let domain = Domain::new();
        let (server, client) = linked(serving(&domain, lane), calling(&domain, lane));
        let answering = thread::spawn(move || {
            for number in 0..ROUNDS {
                let request: Request<[u8], [u8]> = loop {
                    if let Some(request) = server.try_recv().unwrap() {
                        break request;
                    }
                    assert!(wait_readable(&[server.as_fd()], Some(SOON)).unwrap());
                };
                dawdle(number);
                let bytes = request.to_vec();
                request.reply(&bytes).unwrap();
            }
            server
        });
        for number in 0..ROUNDS {
            let mut call = client.send_timeout(&message(number), SOON).unwrap();
            dawdle(number / 3);
            let reply: Reply<[u8]> = loop {
                if let Some(reply) = call.try_wait().unwrap() {
                    break reply;
                }
                assert!(wait_readable(&[client.as_fd()], Some(SOON)).unwrap());
            };
            assert_eq!(*reply, message(number));
        }
        answering.join().unwrap();
    }
}

#[test]
fn futures_are_woken_for_every_request_and_reply() {
    const ROUNDS: u64 = CALLS;
    for lane in LANES {
        let domain = Domain::new();
        let (server, client) = linked(serving(&domain, lane), calling(&domain, lane));
        let server = echo(server, || {});
        let runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = { runtime }.enable_all().build().unwrap();
        runtime.block_on(async {
            let client = client.into_async().unwrap();
            for number in 1..=ROUNDS {
                let bytes = message(number);
                // Two calls at the same time, on one descriptor.
                let (one, other) = tokio::join!(
                    client.call_timeout(&bytes, SOON),
                    client.call_timeout(b"other", SOON)
                );
                assert_eq!(
                    (&*one.unwrap(), &*other.unwrap()),
                    (&bytes[..], &b"other"[..])
                );
            }
            client.call_timeout(&[], SOON).await.unwrap();
        });
        assert_eq!(server.join().unwrap(), 2 * ROUNDS);
    }
}

/// More calls than the server has room for, and more replies than the client has room for.
//= SM2-RNG-012, SM2-SRV-002 test
#[test]
fn calls_that_wait_for_room_are_all_answered() {
    for lane in LANES {
        for way in WAYS {
            let domain = Domain::new();
            let server = serving(&domain, lane).depth(1).max_borrowed(1).wait(way);
            let client = calling(&domain, lane).max_borrowed(1_000).wait(way);
            let (server, client) = linked(server, client);
            let server = echo(server, || {});
            let calls: Vec<_> = (1..=200_u64)
                .map(|number| client.send_timeout(&message(number), SOON).unwrap())
                .collect();
            // The last call first: the replies of the others wait.
            for (index, call) in calls.into_iter().enumerate().rev() {
                let number = index as u64 + 1;
                assert_eq!(*call.wait().unwrap(), message(number));
            }
            client.call_timeout(&[], SOON).unwrap();
            assert_eq!(server.join().unwrap(), 200);
        }
    }
}

/// How often each way of waiting meets new segments.
const SEGMENT_ROUNDS: u64 = if cfg!(feature = "slow") { 4 } else { 1 };

/// Replies in memory that is new to the client, which reads its socket for the segment. It may also read the
/// bell of another reply there.
//= SM2-RNG-012 test
#[test]
fn replies_that_bring_their_segments() {
    for way in WAYS {
        for round in 0..SEGMENT_ROUNDS {
            let domain = Domain::new();
            let server = serving(&domain, true).depth(100).wait(way);
            let client = calling(&domain, true).max_borrowed(1_000).wait(way);
            let (server, client) = linked(server, client);
            let mut served = round;
            let server = echo(server, move || {
                served += 1;
                dawdle(served);
            });
            let size = |seed: u64| 4_000 << (seed % 6);
            let calls: Vec<_> = (1..=90)
                .map(|seed| (client.send_timeout(&pattern(size(seed), seed), SOON)).unwrap())
                .collect();
            for (index, call) in calls.into_iter().enumerate().rev() {
                let seed = index as u64 + 1;
                assert!(*call.wait().unwrap() == *pattern(size(seed), seed));
            }
            client.call_timeout(&[], SOON).unwrap();
            assert_eq!(server.join().unwrap(), 90);
        }
    }
}

/// Another thread may read the reply that a thread waits for.
#[test]
fn threads_that_share_a_client() {
    for lane in LANES {
        for way in WAYS {
            let domain = Domain::new();
            let client = calling(&domain, lane).wait(way);
            let (server, client) = linked(serving(&domain, lane), client);
            let server = echo(server, || {});
            let client = Arc::new(client);
            let threads = [1, 2, 3_u64].map(|which| {
                let client = Arc::clone(&client);
                thread::spawn(move || {
                    for number in 0..CALLS / 2 {
                        let bytes = message(1_000 * which + number);
                        assert!(*client.call_timeout(&bytes, SOON).unwrap() == *bytes);
                        dawdle(number);
                    }
                })
            });
            for thread in threads {
                thread.join().unwrap();
            }
            client.call_timeout(&[], SOON).unwrap();
            assert_eq!(server.join().unwrap(), 3 * (CALLS / 2));
        }
    }
}

/// Calls that are cancelled while they wait at the client, while they are in flight, and while the server
/// handles them.
//= SM2-SRV-003, SM2-RNG-011 test
#[test]
fn a_call_is_cancelled_wherever_it_is() {
    for (lane, len) in LANES.into_iter().flat_map(|it| [(it, 1), (it, 128)]) {
        let domain = Domain::new();
        let server = serving(&domain, lane).depth(1).max_borrowed(1);
        let (server, client) = linked(server, calling(&domain, lane));
        let call = || client.send_timeout(&pattern(len, 1), SOON).unwrap();
        let done = pattern(len, 2);
        let (working, underway, waiting, last) = (call(), call(), call(), call());
        let request = next_request(&server);
        // On the socket lane, the server handles CANCELs in their order: the last one shows that the first arrived. The
        // call that waits at the client is sent later, with its CANCEL directly behind it.
        for call in [&underway, &waiting, &working] {
            call.cancel();
        }
        until(|| request.is_cancelled());
        request.reply(b"too late").unwrap();
        // These CANCELs may or may not arrive in time: the one of a call that waited, and those of the ring lane.
        let mut last = Some(last);
        while let Some(mut call) = last.take() {
            if let Some(request) = server.recv_timeout(Duration::from_millis(1)).unwrap() {
                request.reply(&done).unwrap();
            }
            match call.try_wait().unwrap() {
                Some(reply) => assert_eq!(*reply, *done),
                None => last = Some(call),
            }
        }
        assert_eq!(*working.wait().unwrap(), *b"too late");
        for (cancelled, may_be_late) in [(underway, lane), (waiting, true)] {
            match cancelled.wait() {
                Err(CallError::Cancelled { .. }) => {}
                other => assert_eq!((may_be_late, &*other.unwrap()), (true, &*done)),
            }
        }
        assert!(client.links()[0].end.is_none() && server.links()[0].end.is_none());
    }
}

/// A server that ends: its replies arrive, and all other calls fail at once.
//= SM2-RNG-010, SM2-SRV-004 test
#[test]
fn replies_outlive_their_server() {
    for lane in LANES {
        let domain = Domain::new();
        let (server, client) = linked(serving(&domain, lane), calling(&domain, lane));
        let call = |byte| client.send_timeout(&[byte], SOON).unwrap();
        let (calls, left) = ([1, 2, 3].map(call), [4, 5].map(call));
        for _ in 0..3 {
            let request = next_request(&server);
            let bytes = pattern(10_000, request[0].into());
            request.reply(&bytes).unwrap();
        }
        drop(server);
        for (seed, call) in (1..).zip(calls) {
            assert!(*call.wait().unwrap() == *pattern(10_000, seed));
        }
        for call in left {
            let error = call.wait().unwrap_err();
            assert!(matches!(error, CallError::ServerGone { .. }), "{error}");
        }
        let error = client.call_timeout(b"?", SOON).unwrap_err();
        assert!(matches!(error, CallError::NoServer { .. }), "{error}");
    }
}

/// A client that ends: its requests do not reach the server's program.
#[test]
fn requests_do_not_outlive_their_client() {
    for lane in LANES {
        let domain = Domain::new();
        let (server, client) = linked(serving(&domain, lane), calling(&domain, lane));
        let calls = [1, 2, 3].map(|byte| client.send_timeout(&[byte], SOON).unwrap());
        let request = next_request(&server);
        drop(client);
        drop(calls);
        until(|| request.is_cancelled());
        assert!(server.try_recv().unwrap().is_none());
        assert_eq!(*request, [1], "a request that was taken stays valid");
        request.reply(b"").unwrap_err();
    }
}
