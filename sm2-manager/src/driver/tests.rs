//! The loop, step by step in the thread of a test.

use std::{fs::File, io::IoSlice};

use sm2_io::{
    RecvError, SeqPacket,
    fault::{Call, Fault, Injector},
};
use sm2_proto::{
    Contract, DemandedQos, InterfaceId, Name, OfferedQos, TypeId,
    control::{Limit, Limits, ToManager, encode_to_manager},
};

use super::*;

/// A Manager that serves when a test says so, and the folder of its socket.
struct Steps {
    manager: Manager,
    folder: tempfile::TempDir,
}

impl Steps {
    fn new() -> Self {
        Self::with(Limits::default())
    }

    fn with(limits: Limits) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("domain.sock");
        let options = Options {
            limits,
            ..Options::default()
        };
        let manager = Manager::bind(&path, options).expect("a Manager");
        Self { manager, folder }
    }

    /// Connects a node that has sent HELLO.
    fn greeting(&self, name: &str) -> SeqPacket {
        let path = self.folder.path().join("domain.sock");
        let socket = SeqPacket::connect(&path).expect("a connection");
        let hello = ToManager::Hello {
            min_version: 1,
            max_version: 1,
            name: name.parse().expect("a name"),
            resuming: false,
        };
        send(&socket, &hello);
        socket
    }

    /// Serves until no socket is ready.
    fn serve_all(&mut self) {
        sm2_test_support::until("no socket is ready", || {
            self.serve();
            self.ready().is_empty()
        });
    }

    fn ready(&self) -> Vec<Event> {
        let mut events = Events::with_capacity(256);
        let waited = self.manager.epoll.wait(&mut events, Some(Duration::ZERO));
        waited.expect("events");
        events.iter().collect()
    }

    /// Serves the sockets that are ready now, each once.
    fn serve(&mut self) {
        let ready = self.ready();
        self.manager.serve_all(ready);
    }

    /// Serves until the Manager has welcomed its session with this number.
    fn welcome(&mut self, session: u64) {
        sm2_test_support::until("a session", || {
            self.serve();
            self.manager.machine.is_welcomed(NodeId(session))
        });
    }

    /// Adds a connection for a session that the machine does not know. Returns the other end.
    fn adopt(&mut self, session: u64) -> SeqPacket {
        let (here, there) = SeqPacket::pair().expect("a pair");
        let place = sm2_io::duplicate(&here).expect("a descriptor");
        let connection = Connection::new(here, place, None);
        self.manager.connections.insert(NodeId(session), connection);
        there
    }

    fn connection(&mut self, session: u64) -> &mut Connection {
        let connection = self.manager.connections.get_mut(&NodeId(session));
        connection.expect("a connection")
    }

    /// Sends frames to a session, each with a descriptor.
    fn send_files(&mut self, session: u64, count: usize) {
        for _ in 0..count {
            let file = File::open("/dev/null").expect("a file");
            let sent =
                (self.connection(session)).send(vec![1], Some(Arc::new(file.into())), 1 << 20);
            sent.expect("room in the queue");
        }
    }

    /// Sends frames to a session until one waits.
    fn fill(&mut self, session: u64) {
        while !self.connection(session).is_waiting() {
            let sent = self.connection(session).send(vec![0; 4_096], None, 1 << 20);
            sent.expect("room in the queue");
        }
    }
}

fn send(socket: &SeqPacket, frame: &ToManager) {
    let bytes = encode_to_manager(frame);
    socket.send(&[IoSlice::new(&bytes)], &[]).expect("room");
}

/// How many datagrams have arrived.
fn arrived(socket: &SeqPacket) -> usize {
    let mut buffer = vec![0; DATAGRAM_MAX];
    let received = || match socket.recv(&mut buffer) {
        Ok(_) => true,
        Err(RecvError::WouldBlock | RecvError::Closed) => false,
        Err(error) => panic!("{error}"),
    };
    std::iter::repeat_with(received)
        .take_while(|it| *it)
        .count()
}

const fn readable(token: u64) -> Event {
    Event {
        token,
        readable: true,
        writable: false,
        hangup: false,
    }
}

fn error(errno: i32) -> io::Error {
    io::Error::from_raw_os_error(errno)
}

/// Errors of epoll are not expected, so they are handed over directly.
#[test]
fn an_error_of_waiting_that_may_pass_ends_no_manager() {
    let Steps {
        mut manager,
        folder: _folder,
    } = Steps::new();
    let mut delays = Vec::new();
    for errno in [libc::ENOMEM, libc::EAGAIN, libc::ENOSPC] {
        manager.waited(Err(error(errno))).expect("it tries again");
        delays.push(manager.wait_delay);
    }
    assert_eq!(delays, [1, 2, 4].map(Duration::from_millis));
    manager.waited(Ok(())).expect("events");
    assert_eq!(manager.wait_delay, Duration::ZERO);
    let broken = manager.waited(Err(error(libc::EBADF)));
    assert!(broken.is_err(), "there is nothing to wait for");
}

//= SM2-SES-007, SM2-LNK-002 test
#[test]
fn epochs_and_secrets_are_random_in_each_bit() {
    let drawn: Vec<_> = (0..64).map(|_| random().expect("random numbers")).collect();
    let ones = drawn
        .iter()
        .fold((0, 0), |all, it| (all.0 | it.0, all.1 | it.1));
    let zeros = drawn
        .iter()
        .fold((0, 0), |all, it| (all.0 | !it.0, all.1 | !it.1));
    assert_eq!(
        (ones, zeros),
        ((u64::MAX, u128::MAX), (u64::MAX, u128::MAX))
    );
}

/// A node that declares now and then is served before nodes that never stop.
#[test]
fn the_share_of_a_socket_is_kept_until_it_closes() {
    let mut steps = Steps::new();
    let node = steps.greeting("node");
    const UNKNOWN: u64 = 77;
    let has_used = |steps: &Steps, token| {
        let shares = &steps.manager.shares;
        shares.start_tag(token) > shares.start_tag(UNKNOWN)
    };
    steps.serve();
    assert!(has_used(&steps, LISTENER));
    steps.welcome(1);
    assert!(has_used(&steps, 1));
    drop(node);
    sm2_test_support::until("the end of a session", || {
        steps.serve();
        steps.manager.connections.is_empty()
    });
    assert!(!has_used(&steps, 1));
}

/// Nodes that are not welcomed wait for the closed ones only where a round was too short for these.
//= SM2-SES-003, SM2-SES-009 test
#[test]
fn a_round_says_whether_all_sockets_had_their_turn() {
    let mut steps = Steps::new();
    let nodes = ["one", "two", "three"].map(|name| steps.greeting(name));
    for session in 1..=3 {
        steps.welcome(session);
    }
    sm2_test_support::until("a round with time for three sockets", || {
        for node in &nodes {
            send(node, &ToManager::Query { after: None });
        }
        let ready = steps.ready();
        assert_eq!(ready.len(), 3, "{ready:?}");
        let all = steps.manager.serve_round(ready);
        // The sockets that had no turn are served now.
        while !steps.ready().is_empty() {
            steps.serve();
        }
        let answers: usize = nodes.iter().map(arrived).sum();
        assert!(answers >= 3, "{answers}");
        all
    });
    let many = (1_000..1_000_000).map(readable).collect();
    assert!(!steps.manager.serve_round(many), "in 0.2 ms");
}

//= SM2-SES-009 test
#[test]
fn a_session_has_a_turn_of_32_frames_and_its_end_is_read_at_once() {
    let mut steps = Steps::new();
    let node = steps.greeting("node");
    steps.welcome(1);
    arrived(&node);
    for _ in 0..80 {
        send(&node, &ToManager::Query { after: None });
    }
    let later = clock::now().after(Duration::from_secs(3_600));
    let serve = |steps: &mut Steps, event, until| {
        steps.manager.serve(NodeId(1), event, until);
        arrived(&node)
    };
    assert_eq!(serve(&mut steps, readable(1), later), 32);
    assert_eq!(
        serve(&mut steps, readable(1), clock::now()),
        1,
        "the round is over"
    );
    let only_writable = Event {
        readable: false,
        writable: true,
        ..readable(1)
    };
    assert_eq!(serve(&mut steps, only_writable, later), 0);
    let hangup = Event {
        hangup: true,
        ..readable(1)
    };
    assert_eq!(serve(&mut steps, hangup, later), 80 - 32 - 1);
}

//= SM2-SES-011 test
#[test]
fn the_end_of_a_process_is_the_end_of_its_socket() {
    let mut steps = Steps::new();
    let there = steps.adopt(7);
    let mut ready = vec![
        readable(LISTENER),
        readable(8),
        readable(7),
        readable(7 | PROCESS),
        readable(9 | PROCESS),
    ];
    steps.manager.end_processes(&mut ready);
    let ended = |token| Event {
        hangup: true,
        ..readable(token)
    };
    assert_eq!(ready, [ended(7), readable(8), ended(9), readable(LISTENER)]);
    assert!(matches!(there.recv(&mut [0; 8]), Err(RecvError::Closed)));
    let mut others = vec![readable(8), readable(LISTENER), readable(7)];
    let before = others.clone();
    steps.manager.end_processes(&mut others);
    assert_eq!(others, before);
}

//= SM2-TRN-008 test
#[test]
fn a_node_that_hoards_descriptors_is_given_up_where_they_are_short() {
    let mut steps = Steps::new();
    let _ends = [1, 2].map(|session| {
        let there = steps.adopt(session);
        steps.fill(session);
        there
    });
    steps.send_files(1, 40);
    steps.send_files(2, 64);
    let short = error(libc::EMFILE);
    assert!(!steps.manager.make_descriptors(&short), "64 may wait");
    assert!(steps.manager.given_up.is_empty());
    steps.send_files(2, 1);
    let other = error(libc::ENOBUFS);
    assert!(
        !steps.manager.make_descriptors(&other),
        "descriptors would not help"
    );
    assert!(steps.manager.make_descriptors(&error(libc::ENFILE)));
    assert_eq!(steps.manager.given_up, [NodeId(2)]);
    assert!(
        !steps.manager.make_descriptors(&short),
        "nobody else hoards"
    );
}

//= SM2-TRN-009 test
#[test]
fn a_node_that_leaves_descriptors_unread_is_given_up_where_too_many_are_in_flight() {
    let mut steps = Steps::new();
    let _ends = [1, 2].map(|session| steps.adopt(session));
    steps.send_files(1, 8);
    steps.send_files(2, 32);
    steps.manager.crowded();
    assert!(steps.manager.given_up.is_empty(), "32 may be unread");
    assert!(
        steps.manager.send_again.is_some(),
        "all others are sent later"
    );
    steps.send_files(2, 1);
    steps.manager.crowded();
    assert_eq!(steps.manager.given_up, [NodeId(2)]);
}

//= SM2-TRN-009, SM2-TRN-012 test
#[test]
fn sending_goes_on_once_its_pause_is_over() {
    let mut steps = Steps::new();
    let there = steps.adopt(1);
    steps.fill(1);
    arrived(&there);
    steps.manager.resume_sending();
    assert!(steps.connection(1).is_waiting(), "no pause");
    let later = clock::now().after(Duration::from_secs(3_600));
    steps.manager.send_again = Some(later);
    steps.manager.resume_sending();
    assert!(steps.connection(1).is_waiting(), "the pause goes on");
    assert_eq!(steps.manager.send_again, Some(later));
    steps.manager.send_again = Some(clock::now());
    steps.manager.resume_sending();
    assert!(!steps.connection(1).is_waiting());
    assert_eq!(steps.manager.send_again, None);
    assert_eq!(arrived(&there), 1);
}

/// A node whose socket took a frame, and then no further one, has no room for links yet.
//= SM2-LNK-006 test
#[test]
fn a_node_with_frames_that_wait_gets_no_further_links() {
    const IN_FLIGHT: u32 = 2;
    let limits = Limits::default().with(Limit::LinksInFlight, IN_FLIGHT);
    let mut steps = Steps::with(limits);
    let talker = steps.greeting("talker");
    steps.welcome(1);
    let listener = steps.greeting("listener");
    steps.welcome(2);
    steps.fill(2);
    for number in 0..IN_FLIGHT {
        let topic: Name = format!("topic_{number}").parse().expect("a name");
        let data = TypeId {
            name: "bytes".parse().expect("a name"),
            hash: 0,
        };
        let offer = Contract::Publisher {
            topic: topic.clone(),
            data,
            offer: OfferedQos::new(1),
        };
        let demand = Contract::Subscriber {
            topic,
            data: None,
            demand: DemandedQos::new(1, 1),
        };
        for (socket, contract) in [(&talker, offer), (&listener, demand)] {
            let interface = InterfaceId(u64::from(number) + 1);
            send(
                socket,
                &ToManager::Declare {
                    interface,
                    contract,
                },
            );
        }
    }
    steps.serve_all();
    assert!(steps.manager.machine.awaits_room(NodeId(2)));
    steps.manager.drained.insert(NodeId(2));
    steps.manager.report_sockets();
    assert!(steps.manager.machine.awaits_room(NodeId(2)), "frames wait");
    arrived(&listener);
    steps.serve_all();
    assert!(!steps.manager.machine.awaits_room(NodeId(2)));
}

/// A node that does not read its links costs the others no link, and no node its place in the queue.
//= SM2-TRN-008 test
#[test]
fn a_call_that_lacks_a_descriptor_is_made_again_once_a_hoarder_is_given_up() {
    let short = |call| {
        Injector::new(Fault {
            call,
            nth: 1,
            times: 1,
            errno: libc::EMFILE,
        })
    };
    let later = clock::now().after(Duration::from_secs(3_600));
    for has_hoarder in [true, false] {
        let mut steps = Steps::new();
        let _there = steps.adopt(1_000);
        steps.fill(1_000);
        steps.send_files(1_000, if has_hoarder { 65 } else { 64 });
        let faults = short(Call::SocketPair);
        let installed = faults.install();
        assert_eq!(steps.manager.pair().is_ok(), has_hoarder);
        drop(installed);
        assert_eq!(steps.manager.given_up.len(), usize::from(has_hoarder));

        let mut steps = Steps::new();
        let _there = steps.adopt(1_000);
        steps.fill(1_000);
        steps.send_files(1_000, if has_hoarder { 65 } else { 64 });
        let _node = steps.greeting("node");
        let faults = short(Call::Accept);
        let installed = faults.install();
        steps.manager.accept(later);
        drop(installed);
        // Otherwise the door is closed for a while.
        assert_eq!(steps.manager.door.deadline().is_none(), has_hoarder);
        let sessions = steps.manager.connections.keys();
        let accepted = sessions.filter(|it| it.0 == 1).count();
        assert_eq!(accepted, usize::from(has_hoarder));
    }
}
