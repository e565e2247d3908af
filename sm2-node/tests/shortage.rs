//! Nodes whose system calls fail because the kernel is short of memory.

use std::os::fd::AsFd;
use std::thread;
use std::time::Duration;

use crate::common::threads::{me, until_asleep};
use crate::common::{
    Domain, Endpoint, LANES, SOON, in_slot, meet, next, next_request, pattern, ring_lane, until,
};
use nix::libc;
use sm2_io::fault::{Call, Fault, Injector};
use sm2_node::diagnostics::{End, LinkStatus};
use sm2_node::{
    CallError, DeclareError, Node, Publisher, RecvError, ReplyError, StoreError, Subscriber,
};
use sm2_proto::ViolationKind;

/// The next `times` calls, which fail.
const fn fault(call: Call, errno: i32, times: u64) -> Fault {
    Fault {
        call,
        nth: 1,
        times,
        errno,
    }
}

fn fail(faults: &Injector, call: Call, errno: i32, times: u64) {
    faults.set([fault(call, errno, times)]);
}

/// A node that the calls of this thread drive alone: faults are injected into the calls of one thread.
fn node(domain: &Domain, ring: bool, name: &str) -> Node {
    let builder = domain.builder(name);
    let builder = builder.ring_lane(ring).background(false);
    builder.connect().unwrap()
}

/// A linked publisher and subscriber of two nodes with the ring lane, or without it.
fn pair(domain: &Domain, ring: bool) -> (Publisher<[u8]>, Subscriber<[u8]>) {
    let talker = node(domain, ring, "talker");
    let listener = node(domain, ring, "listener");
    let publisher = talker.publisher_builder("topic").reliable(true);
    let publisher = publisher.declare().unwrap();
    let subscriber = listener.subscriber_builder("topic").reliable(true);
    let subscriber = subscriber.declare().unwrap();
    meet(&publisher, &[&subscriber]);
    (publisher, subscriber)
}

/// The only link, which is open.
fn link(end: &dyn Endpoint) -> LinkStatus {
    let mut links = end.links();
    assert!(
        links.len() == 1 && links[0].open && links[0].end.is_none(),
        "{links:?}"
    );
    links.remove(0)
}

//= SM2-TRN-013 test
#[test]
fn a_shortage_of_memory_ends_no_link_and_loses_no_message() {
    let shortages = [
        (Call::SendMsg, libc::ENOMEM, 1),
        (Call::SendMsg, libc::ENOBUFS, 3),
        (Call::RecvMsg, libc::ENOMEM, 1),
        (Call::RecvMsg, libc::ENOBUFS, 3),
        (Call::EpollWait, libc::ENOMEM, 3),
    ];
    for ring in LANES {
        let domain = Domain::new();
        let (publisher, subscriber) = pair(&domain, ring);
        let id = link(&publisher).id;
        let faults = Injector::counting();
        let _installed = faults.install();
        let mut seed = 0;
        for (call, errno, times) in shortages {
            // Messages in new segments. Each segment needs a packet also on the ring lane.
            for len in [130, 3_000, 300_000] {
                seed += 1;
                let message = pattern(len, seed);
                fail(&faults, call, errno, times);
                publisher.publish(&message).unwrap();
                let case = format!("{call:?} {errno} ring {ring} length {len}");
                until(|| {
                    // Drives the node of the publisher.
                    publisher.links();
                    match subscriber.try_recv().unwrap() {
                        Some(came) => {
                            assert!(*came == *message, "{case}");
                            true
                        }
                        None => false,
                    }
                });
                if !ring {
                    assert_eq!(faults.hits(), times, "{case}");
                }
                faults.set(None);
                assert_eq!(link(&publisher).id, id, "{case}");
                assert_eq!(link(&subscriber).id, id, "{case}");
            }
        }
        assert_eq!(subscriber.lost(), 0);
    }
}

//= SM2-TRN-013 test
#[test]
fn a_link_reports_its_shortage_of_memory() {
    let domain = Domain::new();
    let (publisher, subscriber) = pair(&domain, false);
    let faults = Injector::counting();
    let _installed = faults.install();
    fail(&faults, Call::SendMsg, libc::ENOMEM, u64::MAX);
    publisher.publish(b"held").unwrap();
    assert!(link(&publisher).short_of_memory);
    assert!(subscriber.try_recv().unwrap().is_none());
    faults.set(None);
    assert!(!link(&publisher).short_of_memory);
    assert_eq!(*next(&subscriber), *b"held");
}

/// A thread sleeps until its ring has a message. Nothing but the DOORBELL wakes it.
//= SM2-TRN-013, SM2-RNG-012 test
#[test]
fn a_doorbell_without_memory_is_sent_later() {
    let domain = Domain::new();
    let (publisher, subscriber) = pair(&domain, true);
    let faults = Injector::counting();
    let _installed = faults.install();
    let (more, last) = (in_slot(b"more"), in_slot(b"last"));
    let (came, messages) = thread::scope(|scope| {
        let sleeper = scope.spawn(|| {
            let mut messages = 0;
            loop {
                let came = subscriber.recv_timeout(SOON).unwrap();
                messages += 1;
                match came.as_deref() {
                    Some(bytes) if *bytes == *more => {}
                    came => return (came.map(<[u8]>::to_vec), messages),
                }
            }
        });
        // The ATTACH of the only segment.
        publisher.publish(&more).unwrap();
        let mut published = 1;
        // From here on the socket carries nothing else. A DOORBELL is sent only while the thread sleeps.
        // Drives the node of the publisher, and publishes nothing.
        let is_taken = |published| publisher.links()[0].counters.delivered == published;
        until(|| {
            // A thread that is slow gets every message: there is room for the next one.
            until(|| is_taken(published));
            fail(&faults, Call::SendMsg, libc::ENOMEM, 1);
            published += 1;
            let hit = publisher.publish(&more).is_ok() && faults.hits() == 1;
            faults.set(None);
            hit
        });
        until(|| is_taken(published));
        publisher.publish(&last).unwrap();
        let (came, messages) = sleeper.join().unwrap();
        assert_eq!(messages, published + 1);
        (came, messages)
    });
    assert_eq!(came, Some(last));
    assert!(messages > 1);
}

//= SM2-TRN-013 test
#[test]
fn a_wait_outlasts_a_shortage_of_memory() {
    let domain = Domain::new();
    let (publisher, subscriber) = pair(&domain, false);
    let faults = Injector::counting();
    let _installed = faults.install();
    for (call, times) in [(Call::RecvMsg, 5), (Call::EpollWait, 5), (Call::Poll, 2)] {
        fail(&faults, call, libc::ENOMEM, times);
        let waiting = me();
        let late = thread::scope(|scope| {
            let late = scope.spawn(|| {
                match call {
                    // Only a packet makes the thread read its socket.
                    Call::RecvMsg => until_asleep(waiting),
                    _ => until(|| faults.hits() == times),
                }
                publisher.publish(b"late").unwrap();
            });
            let came = subscriber.recv_timeout(SOON).unwrap();
            late.join().unwrap();
            came
        });
        assert_eq!(late.as_deref(), Some(&b"late"[..]), "{call:?}");
        assert_eq!(faults.hits(), times, "{call:?}");
        faults.set(None);
    }
}

/// A declaration fails, or the descriptor of the node stands for the new interface as well.
#[test]
fn an_interface_that_is_declared_belongs_to_the_descriptor_of_its_node() {
    let calls = [Call::EpollCreate, Call::EpollCtl];
    for (call, nth) in calls.into_iter().flat_map(|it| [(it, 1), (it, 2)]) {
        let domain = Domain::new();
        let listener = node(&domain, false, "listener");
        let faults = Injector::counting();
        let installed = faults.install();
        faults.set([Fault {
            nth,
            ..fault(call, libc::ENOMEM, 1)
        }]);
        let declared = listener.subscriber::<[u8]>("topic");
        let failed = matches!(declared, Err(DeclareError::Io(_)));
        assert_eq!(failed, nth == 1, "{call:?} {nth}: {declared:?}");
        drop(installed);
        let subscriber = declared.or_else(|_| listener.subscriber("topic")).unwrap();
        let talker = node(&domain, false, "talker");
        let publisher = talker.publisher::<[u8]>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        publisher.publish(b"message").unwrap();
        // The packet waits in the socket of the link until the node reads it.
        until(|| {
            talker.spin_some().unwrap();
            listener.spin_some().unwrap();
            let descriptors = [listener.as_fd()];
            !sm2_io::wait_readable(&descriptors, Some(Duration::ZERO)).unwrap()
        });
        assert_eq!(*next(&subscriber), *b"message");
    }
}

/// A program polls the descriptor of its subscriber, which the kernel had no memory to make at first.
//= SM2-TRN-013 test
#[test]
fn a_program_that_polls_hears_of_messages_after_a_shortage() {
    let shortages = [
        (Call::EpollCreate, libc::EMFILE),
        (Call::EpollCtl, libc::ENOMEM),
        (Call::EpollCtl, libc::ENOSPC),
    ];
    for ring in LANES {
        for (call, errno) in shortages {
            let domain = Domain::new();
            let talker = node(&domain, ring, "talker");
            let listener = node(&domain, ring, "listener");
            let publisher = talker.publisher::<[u8]>("topic").unwrap();
            let subscriber = listener.subscriber::<[u8]>("topic").unwrap();
            meet(&publisher, &[&subscriber]);
            // From here on, a ring carries messages without a packet, and the node's descriptor is silent.
            publisher.publish(b"first").unwrap();
            assert_eq!(*next(&subscriber), *b"first");
            listener.spin_some().unwrap();
            let faults = Injector::counting();
            let _installed = faults.install();
            fail(&faults, call, errno, 2);
            let came = thread::scope(|scope| {
                let late = scope.spawn(|| {
                    until(|| faults.hits() == 2);
                    publisher.publish(b"late").unwrap();
                });
                let came = loop {
                    let came = subscriber.try_recv().unwrap();
                    if came.is_some() {
                        break came;
                    }
                    let descriptors = [subscriber.as_fd()];
                    if !sm2_io::wait_readable(&descriptors, Some(SOON)).unwrap() {
                        break None;
                    }
                };
                late.join().unwrap();
                came
            });
            let case = format!("{call:?} {errno} ring {ring}");
            assert_eq!(came.as_deref(), Some(&b"late"[..]), "{case}");
            assert_eq!(faults.hits(), 2, "{case}");
        }
    }
}

/// A thread that waits while a socket is ready and cannot be read pauses between its tries.
//= SM2-TRN-013 test
#[test]
fn a_wait_does_not_spin_while_memory_is_short() {
    let domain = Domain::new();
    let (publisher, subscriber) = pair(&domain, false);
    let faults = Injector::counting();
    let _installed = faults.install();
    for call in [Call::RecvMsg, Call::EpollWait] {
        publisher.publish(b"unread").unwrap();
        fail(&faults, call, libc::ENOMEM, u64::MAX);
        let wait = Duration::from_millis(100);
        assert!(subscriber.recv_timeout(wait).unwrap().is_none());
        // A pause lasts a millisecond or longer, and each try drives the node at most twice.
        let tries = faults.hits();
        assert!((1..=210).contains(&tries), "{call:?} {tries}");
        faults.set(None);
        assert_eq!(*next(&subscriber), *b"unread");
    }
}

/// A client hears that its reply could not be stored, and why. The program of the server does, too. On the ring lane,
/// the text needs a slot. The slot of an earlier reply has room for the whole text, or for its beginning.
#[test]
fn a_client_hears_that_its_reply_could_not_be_stored() {
    let shortages = [
        (Call::MemfdCreate, libc::EMFILE),
        (Call::Mmap, libc::ENOMEM),
    ];
    for (ring, sealed, len) in [
        (true, false, 180),
        (true, false, 2),
        (false, false, 2),
        (false, true, 2),
    ] {
        let domain = Domain::new();
        let server = node(&domain, ring, "server").server_builder::<str, [u8]>("service");
        let server = server.sealed(sealed).declare().unwrap();
        let client = node(&domain, ring, "client").client::<str, [u8]>("service");
        let client = client.unwrap();
        meet(&client, &[&server]);
        let ask = || {
            let asked = client.send_timeout("how?", SOON).unwrap();
            (asked, next_request(&server))
        };
        let (asked, request) = ask();
        request.reply(&pattern(len, 1)).unwrap();
        assert!(*asked.wait().unwrap() == *pattern(len, 1));
        // A sealed reply is written without a mapping.
        let shortages = if sealed { &shortages[..1] } else { &shortages };
        for &(call, errno) in shortages {
            let case = format!("{call:?} {errno} ring {ring} sealed {sealed} length {len}");
            let (asked, request) = ask();
            let faults = Injector::counting();
            let installed = faults.install();
            fail(&faults, call, errno, u64::MAX);
            let error = request.reply(&pattern(300_000, 1)).unwrap_err();
            drop(installed);
            let stored = matches!(&error, ReplyError::Store(StoreError::Io(_)));
            assert!(stored && faults.hits() > 0, "{case}: {error:?}");
            let told = match asked.wait() {
                Err(CallError::Failed { reason, .. }) => reason,
                other => panic!("{case}: {:?}", other.map(drop)),
            };
            let short = "the server could not store the reply";
            let whole = format!("{short}: {error}");
            assert_eq!(
                told,
                if ring && len == 2 { short } else { &whole },
                "{case}"
            );
        }
        let (asked, request) = ask();
        request.reply(&pattern(300_000, 2)).unwrap();
        assert!(*asked.wait().unwrap() == *pattern(300_000, 2));
    }
}

/// A linked publisher and subscriber of sealed messages, with two of these on their way.
fn sealed_pair(domain: &Domain) -> (Publisher<[u8]>, Subscriber<[u8]>, Vec<u8>) {
    let talker = node(domain, ring_lane(), "talker");
    let publisher = talker.publisher::<[u8]>("topic").unwrap();
    let listener = node(domain, ring_lane(), "listener");
    let builder = listener.subscriber_builder::<[u8]>("topic");
    let subscriber = builder.sealed(true).declare().unwrap();
    meet(&publisher, &[&subscriber]);
    let message = pattern(1 << 20, 1);
    publisher.publish(&message).unwrap();
    publisher.publish(&message).unwrap();
    (publisher, subscriber, message)
}

//= SM2-TRN-013 test
#[test]
fn a_sealed_message_without_memory_to_map_it_is_lost_alone() {
    // EAGAIN: `mlockall` keeps the process from mapping more.
    for errno in [libc::ENOMEM, libc::ENFILE, libc::EAGAIN] {
        let domain = Domain::new();
        let (publisher, subscriber, message) = sealed_pair(&domain);
        let id = link(&publisher).id;
        let faults = Injector::counting();
        let installed = faults.install();
        fail(&faults, Call::Mmap, errno, u64::MAX);
        let error = subscriber.recv_timeout(SOON).err();
        assert!(matches!(error, Some(RecvError::Map { .. })), "{error:?}");
        drop(installed);
        assert_eq!(*next(&subscriber), *message);
        assert_eq!(subscriber.lost(), 1);
        assert_eq!(link(&publisher).id, id);
    }
}

/// A call that receives does not fail because of what one sender did: the link of this sender ends, and the call goes
/// on with the messages of others.
//= SM2-SEG-001 test
#[test]
fn a_message_whose_file_cannot_be_mapped_ends_its_link_alone() {
    let domain = Domain::new();
    let (publisher, subscriber, message) = sealed_pair(&domain);
    let (id, code) = (link(&publisher).id, ViolationKind::NotAMemfd.code());
    // The first datagram that a thread reads makes it map its buffer.
    assert_eq!(*next(&subscriber), *message);
    let faults = Injector::counting();
    let installed = faults.install();
    // No file that the checks let through causes this error now: another kernel may. The first call only looks for an
    // address.
    fail(&faults, Call::Mmap, libc::ENODEV, 2);
    assert!(subscriber.try_recv().unwrap().is_none());
    drop(installed);
    assert_eq!(subscriber.lost(), 1);
    // The Manager may have linked the pair anew.
    let mut links = subscriber.links().into_iter();
    assert!(links.all(|it| it.id != id || it.end == Some(End::Local(code))));
    let honest = node(&domain, ring_lane(), "honest");
    let other = honest.publisher::<[u8]>("topic").unwrap();
    until(|| {
        // Both calls drive their nodes.
        let (ours, theirs) = (subscriber.links(), other.links());
        let of_honest = |it: &LinkStatus| it.open && it.peer.name.as_str() == "honest";
        ours.iter().any(of_honest) && theirs.iter().any(|it| it.open)
    });
    other.publish(&message).unwrap();
    assert_eq!(next(&subscriber).publisher().as_str(), "honest");
}

/// The ATTACH of a segment waits in the socket while the ring already has a message in the segment.
//= SM2-TRN-013, SM2-RNG-007 test
#[test]
fn an_attach_that_cannot_be_read_is_no_fault_of_the_publisher() {
    let domain = Domain::new();
    let (publisher, subscriber) = pair(&domain, true);
    let message = pattern(300_000, 1);
    publisher.publish(&message).unwrap();
    let faults = Injector::counting();
    let _installed = faults.install();
    fail(&faults, Call::RecvMsg, libc::ENOMEM, 20);
    until(|| {
        subscriber.try_recv().unwrap();
        faults.hits() >= 3
    });
    let status = link(&subscriber);
    assert!(status.short_of_memory && status.received.messages == 0);
    assert_eq!(*next(&subscriber), *message);
    link(&publisher);
}

//= SM2-TRN-013 test
#[test]
fn a_session_outlasts_a_shortage_of_memory() {
    let shortages = [
        vec![fault(Call::SendMsg, libc::ENOMEM, 3)],
        vec![fault(Call::SendMsg, libc::ETOOMANYREFS, 2)],
        vec![fault(Call::RecvMsg, libc::ENOBUFS, 3)],
        vec![fault(Call::EpollWait, libc::ENOMEM, 3)],
        vec![
            fault(Call::SendMsg, libc::ENOMEM, 1),
            // The first call adds the interface's set, and the second one watches the session.
            Fault {
                nth: 2,
                ..fault(Call::EpollCtl, libc::ENOMEM, 1)
            },
        ],
    ];
    let domain = Domain::new();
    let node = node(&domain, ring_lane(), "node");
    let id = node.id();
    let faults = Injector::counting();
    let _installed = faults.install();
    for (number, shortage) in shortages.into_iter().enumerate() {
        faults.set(shortage.clone());
        let topic = format!("topic_{number}");
        let publisher = node.publisher::<u32>(&topic).unwrap();
        faults.set(None);
        assert!(publisher.links().is_empty());
        assert!(node.snapshot().is_ok());
        assert_eq!(node.id(), id, "{shortage:?}: the session is another one");
    }
}
