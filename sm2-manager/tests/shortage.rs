//! A Manager whose system calls fail because the kernel is short of memory or descriptors.

use std::{
    io::IoSlice,
    os::fd::AsFd,
    sync::mpsc,
    thread::{self, JoinHandle},
    time::Duration,
};

use crate::common::{SOON, TestDomain, eventually};
use nix::libc;
use sm2_io::{
    CounterPage, RecvError, SeqPacket,
    fault::{Call, Fault, Injector},
    wait_readable,
};
use sm2_manager::{HandOver, Manager, Options, Outcome, Stopper};
use sm2_node::{Node, Publisher, Subscriber, domain::LinkId};
use sm2_proto::{
    Datagram,
    control::{ToManager, ToNode, decode_to_node, encode_to_manager},
};

/// A Manager on a thread of its own, with an injector for its system calls.
struct Short {
    domain: TestDomain,
    faults: Injector,
    stopper: Stopper,
    hand_over: HandOver,
    thread: Option<JoinHandle<Outcome>>,
}

impl Short {
    fn start() -> Self {
        let (domain, faults) = (TestDomain::new(), Injector::counting());
        let (path, injector) = (domain.socket(), faults.clone());
        let (started, handles) = mpsc::channel();
        let thread = thread::spawn(move || {
            let manager = Manager::bind(&path, Options::default()).unwrap();
            let handles = (manager.stopper(), manager.hand_over());
            started.send(handles).unwrap();
            let _installed = injector.install();
            manager.run().unwrap()
        });
        let (stopper, hand_over) = handles.recv_timeout(SOON).unwrap();
        Self {
            domain,
            faults,
            stopper,
            hand_over,
            thread: Some(thread),
        }
    }

    fn node(&self, name: &str) -> Node {
        let builder = Node::builder(name).socket(self.domain.socket());
        builder.manager_timeout(SOON).connect().unwrap()
    }

    fn fail(&self, call: Call, errno: i32, times: u64) {
        let fault = Fault {
            call,
            nth: 1,
            times,
            errno,
        };
        self.faults.set(Some(fault));
    }
}

impl Drop for Short {
    fn drop(&mut self) {
        self.stopper.stop();
        let outcome = self.thread.take().unwrap().join();
        if !thread::panicking() {
            assert!(matches!(outcome, Ok(Outcome::Stopped)), "{outcome:?}");
        }
    }
}

/// A publisher and a subscriber of the same topic, each in a node of its own.
struct Pair {
    talker: Node,
    listener: Node,
    publisher: Publisher<u32>,
    subscriber: Subscriber<u32>,
}

impl Pair {
    fn linked(domain: &Short, topic: &str) -> Self {
        let talker = domain.node(&format!("{topic}_talker"));
        let listener = domain.node(&format!("{topic}_listener"));
        let publisher = talker.publisher::<u32>(topic).unwrap();
        let subscriber = listener.subscriber::<u32>(topic).unwrap();
        let pair = Self {
            talker,
            listener,
            publisher,
            subscriber,
        };
        eventually("a link", || {
            pair.drive();
            pair.publisher.links().iter().any(|it| it.open)
        });
        pair
    }

    fn drive(&self) {
        self.talker.spin_some().unwrap();
        self.listener.spin_some().unwrap();
    }

    /// The only link, which is open.
    fn link(&self) -> LinkId {
        self.drive();
        let links = self.publisher.links();
        assert!(
            links.len() == 1 && links[0].open && links[0].end.is_none(),
            "{links:?}"
        );
        links[0].id
    }

    fn carries(&self, value: u32) {
        assert_eq!(self.publisher.publish(&value).unwrap().links, 1);
        let sample = self.subscriber.recv_timeout(SOON).unwrap();
        assert_eq!(sample.map(|it| *it), Some(value));
    }
}

//= SM2-TRN-012, SM2-LNK-008 test
#[test]
fn a_shortage_of_the_managers_ends_no_session_and_no_link() {
    let shortages = [
        (Call::SendMsg, libc::ENOMEM, 1),
        (Call::SendMsg, libc::ENOBUFS, 5),
        (Call::RecvMsg, libc::ENOMEM, 1),
        (Call::RecvMsg, libc::ENOBUFS, 5),
        (Call::EpollWait, libc::ENOMEM, 3),
        (Call::EpollCtl, libc::ENOMEM, 1),
        (Call::EpollCtl, libc::ENOSPC, 2),
        (Call::SocketPair, libc::ENOMEM, 1),
        (Call::SocketPair, libc::ENFILE, 2),
        (Call::Accept, libc::ENOBUFS, 1),
    ];
    let domain = Short::start();
    let first = Pair::linked(&domain, "first");
    let link = first.link();
    for (number, (call, errno, times)) in (1..).zip(shortages) {
        domain.fail(call, errno, times);
        // The first frame that the Manager cannot read or send is one of an old session.
        let other = first.talker.publisher::<u32>(&format!("other_{number}"));
        assert!(other.is_ok(), "{call:?} {errno}");
        let next = Pair::linked(&domain, &format!("topic_{number}"));
        next.carries(number);
        assert_eq!(domain.faults.hits(), times, "{call:?} {errno}");
        assert_eq!(first.link(), link, "{call:?} {errno}");
        first.carries(number);
    }
}

/// No successor comes, and the first attempt to watch the listening socket again fails.
//= SM2-TRN-012, SM2-RES-009 test
#[test]
fn a_domain_that_was_taken_back_accepts_nodes_although_its_socket_cannot_be_watched_at_once() {
    let domain = Short::start();
    // The first call stops watching the socket.
    domain.faults.set(Some(Fault {
        call: Call::EpollCtl,
        nth: 2,
        times: 1,
        errno: libc::ENOMEM,
    }));
    domain.hand_over.start();
    eventually("a failed call", || domain.faults.hits() == 1);
    drop(domain.node("late"));
}

/// A node that sends many frames before it reads the answers.
fn greet(domain: &Short) -> SeqPacket {
    let socket = SeqPacket::connect(&domain.domain.socket()).unwrap();
    let hello = ToManager::Hello {
        min_version: 1,
        max_version: 1,
        name: "node".parse().unwrap(),
        resuming: false,
    };
    send(&socket, &hello);
    assert!(matches!(read(&socket), ToNode::Welcome { .. }));
    socket
}

fn send(socket: &SeqPacket, frame: &ToManager) {
    let frame = encode_to_manager(frame);
    eventually("room in the socket", || {
        socket.send(&[IoSlice::new(&frame)], &[]).is_ok()
    });
}

fn read(socket: &SeqPacket) -> ToNode {
    let mut buffer = vec![0; 65_536];
    loop {
        match socket.recv(&mut buffer) {
            Ok(received) => {
                return decode_to_node(&Datagram::new(&buffer[..received.len])).unwrap();
            }
            Err(RecvError::WouldBlock) => {
                let ready = wait_readable(&[socket.as_fd()], Some(SOON)).unwrap();
                assert!(ready, "the Manager sends no frame");
            }
            Err(error) => panic!("{error}"),
        }
    }
}

/// The Manager asks the kernel to report room only once a socket is full, and that request fails.
//= SM2-TRN-012 test
#[test]
fn frames_that_wait_for_room_are_sent_although_the_socket_cannot_be_watched() {
    const QUERIES: usize = 1_000;
    let domain = Short::start();
    let socket = greet(&domain);
    domain.fail(Call::EpollCtl, libc::ENOMEM, 1);
    for _ in 0..QUERIES {
        send(&socket, &ToManager::Query { after: None });
    }
    eventually("a full socket", || domain.faults.hits() == 1);
    for _ in 0..QUERIES {
        assert!(matches!(read(&socket), ToNode::Page(_)));
    }
}

/// The stopper is an event, and the Manager cannot wait for events.
//= SM2-TRN-012 test
#[test]
fn a_manager_that_cannot_wait_for_events_can_be_stopped() {
    let domain = Short::start();
    domain.fail(Call::EpollWait, libc::ENOMEM, u64::MAX);
    // It waits without an end until a node connects.
    let _socket = SeqPacket::connect(&domain.domain.socket()).unwrap();
    eventually("failed calls", || domain.faults.hits() > 2);
    domain.stopper.stop();
    let thread = domain.thread.as_ref().unwrap();
    eventually("the end", || thread.is_finished());
}

/// A Manager in whose domain nothing happens sleeps.
#[test]
fn an_idle_manager_waits_without_a_break() {
    let domain = Short::start();
    let pair = Pair::linked(&domain, "topic");
    pair.link();
    let waits = || domain.faults.counts().get(&Call::EpollWait).copied();
    domain.faults.set(None);
    thread::sleep(Duration::from_millis(50));
    assert!(waits().unwrap_or(0) < 100, "{:?}", waits());
    pair.carries(1);
}

/// Without memory for the facts about a counters file, the Manager does without the file. The node has done nothing
/// wrong.
//= SM2-TRN-011, SM2-TRN-012 test
#[test]
fn a_file_that_the_manager_has_no_memory_to_look_at_is_lost_and_no_violation() {
    let domain = Short::start();
    let socket = greet(&domain);
    let page = CounterPage::new().unwrap();
    domain.fail(Call::Stat, libc::ENOMEM, 1);
    let counters = encode_to_manager(&ToManager::Counters);
    let sent = socket.send(&[IoSlice::new(&counters)], &[page.as_fd()]);
    sent.unwrap();
    send(&socket, &ToManager::Query { after: None });
    assert!(
        matches!(read(&socket), ToNode::Page(_)),
        "the session goes on"
    );
    assert_eq!(domain.faults.hits(), 1);
}
