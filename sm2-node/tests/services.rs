//! Services with a real Manager, in one process.

use std::thread::{self, JoinHandle};
use std::time::Duration;

use crate::common::{Domain, SOON, next_request, pattern, until};
use sm2_node::{Call, CallError, Client, DeclareError, Message, Node, ReplyError, Request, Server};

/// Runs a server on its own thread, until a request of one byte `0` stops it.
fn echo(node: &Node, name: &'static str) -> JoinHandle<usize> {
    let server = node.server::<[u8], [u8]>("echo").unwrap();
    thread::Builder::new()
        .name(name.to_owned())
        .spawn(move || {
            let mut served = 0;
            loop {
                let request = next_request(&server);
                if *request == [0] {
                    request.reply(&[]).unwrap();
                    return served;
                }
                served += 1;
                let reply = request.to_vec();
                request.reply(&reply).unwrap();
            }
        })
        .unwrap()
}

fn client(node: &Node, servers: usize) -> Client<[u8], [u8]> {
    let client = node.client("echo").unwrap();
    client.wait_for_servers_timeout(servers, SOON).unwrap();
    client
}

/// Calls the client and its servers, all of one thread, in turn until their links are open.
fn open_links<Q: Message + ?Sized, R: Message + ?Sized>(
    client: &Client<Q, R>,
    servers: &[Server<Q, R>],
) {
    let step = Duration::from_millis(1);
    while client
        .wait_for_servers_timeout(servers.len(), step)
        .is_err()
    {
        for server in servers {
            assert!(server.try_recv().unwrap().is_none(), "no call was made");
        }
    }
}

/// Returns a linked client and server of one thread: each is called in turn until the link is open.
fn pair<Q: Message + ?Sized, R: Message + ?Sized>(domain: &Domain) -> (Server<Q, R>, Client<Q, R>) {
    let server = domain.node("server").server::<Q, R>("service").unwrap();
    let client = domain.node("client").client::<Q, R>("service").unwrap();
    open_links(&client, std::slice::from_ref(&server));
    (server, client)
}

#[test]
fn requests_and_replies_of_every_size_and_form() {
    for sealed in [false, true] {
        let domain = Domain::new();
        let server = echo(&domain.node("server"), "echo");
        let builder = domain.node("client").client_builder::<[u8], [u8]>("echo");
        let client = builder.sealed(sealed).declare().unwrap();
        for (seed, size) in (1..).zip([0, 2, 4095, 4096, 4097, 1 << 20]) {
            let bytes = pattern(size, seed);
            let reply = client.call_timeout(&bytes, SOON).unwrap();
            assert!(*reply == *bytes, "{size} bytes, sealed {sealed}");
            assert_eq!(reply.server().as_str(), "server");
        }
        drop(client.call_timeout(&[0], SOON).unwrap());
        assert_eq!(server.join().unwrap(), 6);
    }
}

#[test]
fn many_calls_at_once_are_answered_each_by_its_own_reply() {
    let domain = Domain::new();
    let server = echo(&domain.node("server"), "echo");
    let client = client(&domain.node("client"), 1);
    let calls: Vec<_> = (0..64_u64)
        .map(|seed| client.send_timeout(&pattern(5000, seed), SOON).unwrap())
        .collect();
    let error = client.send_timeout(b"one more", SOON).unwrap_err();
    assert!(
        matches!(error, CallError::TooManyCalls { limit: 64, .. }),
        "{error}"
    );
    // The last call first: replies that arrive earlier wait.
    for (seed, call) in calls.into_iter().enumerate().rev() {
        assert!(*call.wait().unwrap() == *pattern(5000, seed as u64));
    }
    drop(client.call_timeout(&[0], SOON).unwrap());
    assert_eq!(server.join().unwrap(), 64);
}

//= SM2-SRV-005 test
#[test]
fn a_server_whose_replies_are_held_is_not_chosen_while_another_has_room() {
    let domain = Domain::new();
    let servers = ["one", "two"].map(|name| {
        let node = domain.node(name);
        node.server::<[u8], str>("service").unwrap()
    });
    let node = domain.node("client");
    let client = node.client_builder::<[u8], str>("service");
    let client = client.max_borrowed(2).declare().unwrap();
    open_links(&client, &servers);
    let send = |id| client.send_timeout(&[id], SOON).unwrap();
    let served = |server: usize, id| {
        let request = next_request(&servers[server]);
        assert_eq!(request[0], id);
        request
    };
    // A reply that needs a slot.
    let reply = "held ".repeat(25);
    let calls = [send(0), send(1)];
    served(0, 0).reply(&reply).unwrap();
    let _pending = served(1, 1);
    let [first, _] = calls;
    let _held = first.wait().unwrap();
    // Both servers have one: a reply that is held, and a call. The next call goes to the older one.
    let second = send(2);
    served(0, 2).reply(&reply).unwrap();
    let _held_too = second.wait().unwrap();
    // The first server has no call, but two replies are held, which is the limit.
    let _third = send(3);
    served(1, 3).reply(&reply).unwrap();
}

//= SM2-SRV-005 test
#[test]
fn a_call_goes_to_the_server_with_the_fewest_calls_and_to_the_oldest_among_equals() {
    let domain = Domain::new();
    let servers: Vec<_> = ["one", "two", "three"]
        .iter()
        .map(|name| domain.node(name).server::<[u8], str>("service").unwrap())
        .collect();
    let client = domain
        .node("client")
        .client::<[u8], str>("service")
        .unwrap();
    assert_eq!(client.matched(), 3);
    open_links(&client, &servers);
    let calls: Vec<_> = (0..6)
        .map(|id| client.send_timeout(&[id], SOON).unwrap())
        .collect();
    let mut requests: Vec<_> = servers
        .iter()
        .map(|server| [next_request(server), next_request(server)])
        .collect();
    let got: Vec<_> = requests.iter().map(|[a, b]| [a[0], b[0]]).collect();
    assert_eq!(got, [[0, 3], [1, 4], [2, 5]]);
    // The third server becomes free, so the next call goes to it.
    let [first, _second] = requests.pop().unwrap();
    first.reply("done").unwrap();
    let mut calls = calls.into_iter();
    assert_eq!(&*calls.nth(2).unwrap().wait().unwrap(), "done");
    let _call = client.send_timeout(&[6], SOON).unwrap();
    assert_eq!(next_request(&servers[2])[0], 6);
}

#[test]
fn several_clients_and_servers() {
    let domain = Domain::new();
    let servers = [
        echo(&domain.node("s1"), "s1"),
        echo(&domain.node("s2"), "s2"),
    ];
    let clients: Vec<_> = (0..3)
        .map(|number| {
            let node = domain.node(&format!("c{number}"));
            thread::spawn(move || {
                let client = client(&node, 2);
                for seed in 0..100 {
                    let bytes = pattern(100 + seed as usize, seed + 1000 * number);
                    assert!(*client.call_timeout(&bytes, SOON).unwrap() == *bytes);
                }
            })
        })
        .collect();
    for client in clients {
        client.join().unwrap();
    }
    // Two calls at the same time go to different servers.
    let client = client(&domain.node("last"), 2);
    let stop = [0, 0].map(|byte| client.send_timeout(&[byte], SOON).unwrap());
    for call in stop {
        drop(call.wait().unwrap());
    }
    let served: usize = servers.map(|server| server.join().unwrap()).iter().sum();
    assert_eq!(served, 300);
}

#[test]
fn types_must_agree() {
    let domain = Domain::new();
    let node = domain.node("server");
    let _server = node.server::<[f64], f64>("sum").unwrap();
    let error = domain
        .node("client")
        .client::<[f64], f32>("sum")
        .unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, DeclareError::ServiceMismatch { .. }));
    assert!(text.contains("f64-list") && text.contains("f32 "), "{text}");
}

#[test]
fn a_call_without_a_server_fails_at_once() {
    let domain = Domain::new();
    let client = domain
        .node("client")
        .client::<[u8], [u8]>("nobody")
        .unwrap();
    // If it waited, it would end with another error.
    let error = client.call_timeout(b"?", SOON).unwrap_err();
    assert!(matches!(error, CallError::NoServer { .. }), "{error}");
}

//= SM2-SRV-001, SM2-SRV-002 test
#[test]
fn a_deadline_ends_the_call_on_both_sides() {
    let domain = Domain::new();
    let (server, client) = pair::<[u8], [u8]>(&domain);
    let (request, call) = taken_in_time(&server, &client);
    let error = call.wait().unwrap_err();
    assert!(
        matches!(error, CallError::DeadlineExceeded { .. }),
        "{error}"
    );
    assert!(request.deadline().unwrap() <= sm2_node::now());
    assert!(request.is_cancelled());
    // The reply is too late, and has no effect.
    request.reply(b"late").unwrap();
    // A request that is not taken in time is answered automatically.
    let call = client
        .send_timeout(b"untaken", Duration::from_millis(30))
        .unwrap();
    let mut patient = client.send_timeout(b"patient", SOON).unwrap();
    assert!(matches!(
        call.wait().unwrap_err(),
        CallError::DeadlineExceeded { .. }
    ));
    let request = next_request(&server);
    assert_eq!(&*request, b"patient");
    assert!(patient.try_wait().unwrap().is_none());
    request.reply(b"here").unwrap();
    assert_eq!(&*patient.wait().unwrap(), b"here");
    assert_eq!(client.links()[0].counters.in_flight, 0);
}

/// A request at its server, and the call of its client.
type Taken = (Request<[u8], [u8]>, Call<[u8]>);

/// Sends calls with longer and longer timeouts, until the server takes one before its deadline.
fn taken_in_time(server: &Server<[u8], [u8]>, client: &Client<[u8], [u8]>) -> Taken {
    let mut timeout = Duration::from_millis(30);
    while timeout < SOON {
        let call = client.send_timeout(b"slow", timeout).unwrap();
        if let Some(request) = server.recv_timeout(timeout).unwrap()
            && !request.is_cancelled()
        {
            return (request, call);
        }
        timeout *= 2;
    }
    panic!("no call is taken in time");
}

#[test]
fn a_cancelled_call_is_known_to_both_sides() {
    let domain = Domain::new();
    let (server, client) = pair::<[u8], [u8]>(&domain);
    let call = client.send_timeout(b"a", SOON).unwrap();
    let request = next_request(&server);
    call.cancel();
    assert!(request.is_cancelled());
    drop(request);
    let error = call.wait().unwrap_err();
    assert!(matches!(error, CallError::Cancelled { .. }), "{error}");
    // Cancelled before it was taken: the server's program never sees it.
    let call = client.send_timeout(b"b", SOON).unwrap();
    drop(call);
    let call = client.send_timeout(b"c", SOON).unwrap();
    // Reads the socket, which has the cancellation. On the ring lane, a call reads it now and then.
    server.links();
    let request = next_request(&server);
    assert_eq!(&*request, b"c");
    // A reply that overtakes the cancellation counts.
    request.reply(b"quick").unwrap();
    call.cancel();
    assert_eq!(&*call.wait().unwrap(), b"quick");
}

#[test]
fn a_request_that_is_refused_or_dropped_is_answered_all_the_same() {
    let domain = Domain::new();
    let (server, client) = pair::<[u8], [u8]>(&domain);
    let call = client.send_timeout(b"x", SOON).unwrap();
    next_request(&server).fail("no can do").unwrap();
    let error = call.wait().unwrap_err();
    assert!(
        matches!(&error, CallError::Failed { reason, .. } if reason == "no can do"),
        "{error}"
    );
    let call = client.send_timeout(b"x", SOON).unwrap();
    drop(next_request(&server));
    let error = call.wait().unwrap_err();
    assert!(
        matches!(&error, CallError::Failed { reason, .. } if reason.contains("dropped")),
        "{error}"
    );
    let call = client.send_timeout(b"x", SOON).unwrap();
    let long = "ü".repeat(50_000);
    next_request(&server).fail(&long).unwrap();
    let error = call.wait().unwrap_err();
    assert!(matches!(&error, CallError::Failed { reason, .. } if *reason == long));
}

//= SM2-SRV-004 test
#[test]
fn a_server_that_ends_fails_its_calls_at_once() {
    let domain = Domain::new();
    let (server, client) = pair::<[u8], [u8]>(&domain);
    let calls = [b"a", b"b"].map(|it| client.send_timeout(it, SOON).unwrap());
    let request = next_request(&server);
    drop(server);
    drop(request);
    let [first, second] = calls;
    // The taken request is answered when it is dropped; the server lives until then.
    assert!(matches!(
        first.wait().unwrap_err(),
        CallError::Failed { .. }
    ));
    assert!(matches!(
        second.wait().unwrap_err(),
        CallError::ServerGone { .. }
    ));
    assert!(matches!(
        client.call_timeout(b"c", SOON).unwrap_err(),
        CallError::NoServer { .. }
    ));
}

#[test]
fn a_client_that_ends_is_known_to_the_server() {
    let domain = Domain::new();
    let (server, client) = pair::<[u8], [u8]>(&domain);
    let call = client.send(b"a").unwrap();
    let request = next_request(&server);
    drop(call);
    drop(client);
    assert!(request.is_cancelled());
    let error = request.reply(b"anybody?").unwrap_err();
    assert!(matches!(error, ReplyError::ClientGone { .. }), "{error}");
}

#[test]
fn a_descriptor_is_readable_when_there_may_be_a_reply() {
    use std::os::fd::AsFd;
    let domain = Domain::new();
    let (server, client) = pair::<[u8], [u8]>(&domain);
    let readable = |timeout| sm2_io::wait_readable(&[client.as_fd()], Some(timeout)).unwrap();
    let mut call = client.send_timeout(b"a", SOON).unwrap();
    assert!(readable(SOON));
    // It may be readable more than once without a reply, but not for ever.
    until(|| {
        assert!(call.try_wait().unwrap().is_none());
        !readable(Duration::ZERO)
    });
    next_request(&server).reply(b"b").unwrap();
    assert!(readable(SOON));
    let reply = loop {
        if let Some(reply) = call.try_wait().unwrap() {
            break reply;
        }
    };
    assert_eq!(&*reply, b"b");
}

/// After the reply there is no further result, not even an error when the deadline has passed.
#[test]
fn a_call_that_has_its_reply_does_not_fail_at_its_deadline() {
    let domain = Domain::new();
    let (server, client) = pair::<[u8], [u8]>(&domain);
    let mut is_tried = false;
    until(|| {
        let (request, mut call) = taken_in_time(&server, &client);
        let deadline = request.deadline().unwrap();
        request.reply(b"here").unwrap();
        // The reply of a busy machine can be too late.
        is_tried = matches!(call.try_wait(), Ok(Some(_)));
        if is_tried {
            until(|| sm2_node::now() > deadline);
            assert!(call.try_wait().unwrap().is_none());
        }
        is_tried
    });
}

/// Services have no quality of service, so the error must not mention it.
#[test]
fn who_waits_in_vain_is_told_what_to_look_at() {
    let domain = Domain::new();
    let node = domain.node("node");
    let wait = Duration::from_millis(1);
    let client = node.client::<u8, u8>("service").unwrap();
    let error = client
        .wait_for_servers_timeout(1, wait)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("0 of 1 servers") && !error.contains("QoS"),
        "{error}"
    );
    let publisher = node.publisher::<u8>("topic").unwrap();
    let error = publisher
        .wait_for_subscribers_timeout(1, wait)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("0 of 1 subscribers") && error.contains("QoS"),
        "{error}"
    );
}
