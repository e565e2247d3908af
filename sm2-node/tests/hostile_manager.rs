//! Managers that break the protocol or refuse the node while it reconnects. The node leaves them, its links
//! stay open, and it declares everything to the next Manager.

use std::io::IoSlice;
use std::os::fd::AsFd;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use crate::common::{SOON, until};
use sm2_io::{Listener, RecvError, SeqPacket, wait_readable};
use sm2_node::domain::{Contract, DemandedQos, InterfaceId, LinkId, LinkPeer, NodeId};
use sm2_node::{CallError, ConnectError, Name, Node, NodeBuilder, Publisher};
use sm2_proto::control::{Changes, Page, ToManager, ToNode, decode_to_manager, encode_to_node};
use sm2_proto::{Datagram, Farewell, FdFacts, LinkKey, Refusal, Seals, violation};

/// A Manager that the test controls. It runs on the thread of the node, which is called while the Manager
/// waits.
struct Manager {
    listener: Listener,
    node: Option<Node>,
    _folder: tempfile::TempDir,
}

const INTERFACE: InterfaceId = InterfaceId(1);
const LINK: LinkId = LinkId {
    epoch: 1,
    serial: 1,
};

impl Manager {
    /// Returns a Manager without a session, and the path of its socket.
    fn listening() -> (Self, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("test.sock");
        let manager = Self {
            listener: Listener::bind(&path, 4).unwrap(),
            node: None,
            _folder: folder,
        };
        (manager, path)
    }

    /// Returns a Manager with a node that has declared a publisher, and the other end of its link.
    fn with_linked_node() -> (Self, Publisher<u8>, SeqPacket) {
        let (mut manager, path) = Self::listening();
        let connecting = std::thread::spawn(move || {
            let node = builder(path).connect().unwrap();
            let publisher = node.publisher::<u8>("topic").unwrap();
            (node, publisher)
        });
        let session = manager.accept();
        assert!(matches!(
            manager.read(&session),
            ToManager::Hello {
                resuming: false,
                ..
            }
        ));
        welcome(&session, 1);
        assert!(matches!(manager.read(&session), ToManager::Declare { .. }));
        send(&session, &declared(1));
        let (node, publisher) = connecting.join().unwrap();
        manager.node = Some(node);
        let (theirs, ours) = SeqPacket::pair().unwrap();
        let frame = encode_to_node(&link());
        session
            .send(&[IoSlice::new(&frame)], &[theirs.as_fd()])
            .unwrap();
        drop(theirs);
        until(|| !publisher.links().is_empty());
        ours.send(&[IoSlice::new(&open())], &[]).unwrap();
        until(|| publisher.links()[0].open);
        (manager, publisher, ours)
    }

    fn drive(&self) {
        if let Some(node) = &self.node {
            node.spin_some().unwrap();
        }
    }

    fn accept(&self) -> SeqPacket {
        let deadline = Instant::now() + SOON;
        loop {
            self.drive();
            wait_readable(&[self.listener.as_fd()], Some(Duration::from_millis(1))).unwrap();
            if let Some(session) = self.listener.accept().unwrap() {
                return session;
            }
            assert!(Instant::now() < deadline, "the node does not connect");
        }
    }

    /// Returns the next frame that is none of COUNTERS, SCHEMA and MAX_LINKS.
    fn read(&self, session: &SeqPacket) -> ToManager {
        self.try_read(session).expect("a frame")
    }

    /// As [`read`](Self::read); `None` if the node has closed the connection.
    fn try_read(&self, session: &SeqPacket) -> Option<ToManager> {
        let deadline = Instant::now() + SOON;
        let mut buffer = vec![0; 65_536];
        loop {
            self.drive();
            wait_readable(&[session.as_fd()], Some(Duration::from_millis(1))).unwrap();
            let received = match session.recv(&mut buffer) {
                Ok(received) => received,
                Err(RecvError::WouldBlock) => {
                    assert!(Instant::now() < deadline, "the node sends no frame");
                    continue;
                }
                Err(RecvError::Closed) => return None,
                Err(error) => panic!("{error}"),
            };
            let facts = FdFacts {
                regular: true,
                seals: Seals(u32::MAX),
                size_bytes: 1_024,
            };
            let facts = vec![facts; received.fds.into_iter().count()];
            let datagram = Datagram {
                fds: &facts,
                ..Datagram::new(&buffer[..received.len])
            };
            match decode_to_manager(&datagram).unwrap() {
                ToManager::Counters | ToManager::Schema(_) | ToManager::MaxLinks { .. } => {}
                frame => return Some(frame),
            }
        }
    }

    /// Accepts the next session, up to the renewed DECLARE.
    fn resume(&self, epoch: u64) -> SeqPacket {
        let session = self.accept();
        assert!(matches!(
            self.read(&session),
            ToManager::Hello { resuming: true, .. }
        ));
        welcome(&session, epoch);
        assert!(matches!(
            self.read(&session),
            ToManager::Declare {
                interface: INTERFACE,
                ..
            }
        ));
        session
    }

    /// Adopts the link, as a correct Manager does. Returns the frames of the node.
    #[must_use]
    fn adopt(&self, epoch: u64) -> SeqPacket {
        let session = self.resume(epoch);
        send(&session, &declared(0));
        assert!(matches!(
            self.read(&session),
            ToManager::Claim {
                interface: INTERFACE,
                link: LINK,
                key: LinkKey(7),
                ..
            }
        ));
        assert_eq!(self.read(&session), ToManager::Claimed);
        let node = self.node.as_ref().unwrap();
        node.wait_connected_timeout(SOON).unwrap();
        assert_eq!(node.epoch(), Some(epoch));
        session
    }
}

fn builder(path: PathBuf) -> NodeBuilder {
    let builder = Node::builder("node").socket(path);
    builder.manager_timeout(SOON)
}

fn send(session: &SeqPacket, frame: &ToNode) {
    let frame = encode_to_node(frame);
    session.send(&[IoSlice::new(&frame)], &[]).unwrap();
}

fn welcome(session: &SeqPacket, epoch: u64) {
    let node = NodeId(epoch);
    let version = 1;
    send(
        session,
        &ToNode::Welcome {
            version,
            epoch,
            node,
        },
    );
}

fn declared(matches: u32) -> ToNode {
    ToNode::Declared {
        interface: INTERFACE,
        matches,
    }
}

fn link() -> ToNode {
    let demand = DemandedQos::new(8, 4);
    ToNode::Link {
        interface: INTERFACE,
        link: LINK,
        key: LinkKey(7),
        version: 1,
        reliable: false,
        sealed: false,
        peer: LinkPeer {
            node: NodeId(9),
            name: Name::new("peer").unwrap(),
            interface: InterfaceId(1),
            contract: Contract::Subscriber {
                topic: Name::new("topic").unwrap(),
                data: None,
                demand,
            },
        },
    }
}

/// An OPEN of a receiver with a window of 12, for messages of up to 1,024 bytes.
fn open() -> [u8; 48] {
    let mut frame = [0; 48];
    (frame[0], frame[1], frame[2], frame[4]) = (1, 1, 1, 12);
    (frame[8], frame[16], frame[24], frame[28]) = (1, 1, 1, 1);
    frame
}

/// Checks that the link still carries messages.
fn carries(publisher: &Publisher<u8>, peer: &SeqPacket) {
    assert!(publisher.links()[0].open);
    publisher.publish(&5).unwrap();
    let mut buffer = vec![0; 65_536];
    loop {
        wait_readable(&[peer.as_fd()], Some(SOON)).unwrap();
        let received = peer.recv(&mut buffer).unwrap();
        if buffer[0] == 4 {
            assert_eq!(received.len, 49);
            break;
        }
    }
    let mut release = [0; 16];
    (release[0], release[2]) = (7, 1);
    release[8..].copy_from_slice(&buffer[16..24]);
    peer.send(&[IoSlice::new(&release)], &[]).unwrap();
}

//= SM2-NOD-001, SM2-NOD-003, SM2-RES-001, SM2-RES-002 test
#[test]
fn a_manager_that_breaks_the_protocol_while_a_node_comes_back_is_left() {
    let (manager, publisher, peer) = Manager::with_linked_node();
    carries(&publisher, &peer);
    let wrong = [
        // Before WELCOME.
        (
            None,
            declared(0),
            violation!(ExpectedWelcome, "SM2-NOD-001"),
        ),
        // DECLARED in the wrong order.
        (
            Some(2),
            ToNode::Declared {
                interface: InterfaceId(9),
                matches: 0,
            },
            violation!(UnknownInterface, "SM2-LNK-003"),
        ),
        // UNLINK of a link that the node never had.
        (
            Some(3),
            ToNode::Unlink {
                interface: INTERFACE,
                link: LinkId {
                    epoch: 3,
                    serial: 1,
                },
                code: Farewell::PeerGone.code(),
            },
            violation!(UnknownInterface, "SM2-LNK-003"),
        ),
        // An answer to a query that the node never sent.
        (
            Some(4),
            ToNode::Changes(Changes {
                revision: 1,
                changes: None,
                more: false,
            }),
            violation!(UnexpectedChanges, "SM2-WCH-001"),
        ),
    ];
    for (epoch, frame, violation) in wrong {
        let session = match epoch {
            Some(epoch) => manager.resume(epoch),
            None => {
                let session = manager.accept();
                assert!(matches!(
                    manager.read(&session),
                    ToManager::Hello { resuming: true, .. }
                ));
                session
            }
        };
        send(&session, &frame);
        let code = violation.code();
        assert_eq!(manager.read(&session), ToManager::Goodbye { code });
        assert_eq!(manager.try_read(&session), None, "it hangs up");
        assert!(!manager.node.as_ref().unwrap().is_connected());
        carries(&publisher, &peer);
    }
    let _session = manager.adopt(5);
    carries(&publisher, &peer);
    assert!(publisher.is_registered());
}

//= SM2-RES-001 test
#[test]
fn managers_that_go_or_refuse_while_a_node_comes_back_are_followed_by_others() {
    let (manager, publisher, peer) = Manager::with_linked_node();
    // The Manager ends before HELLO, before WELCOME, later, and after DECLARED.
    drop(manager.accept());
    let session = manager.accept();
    manager.read(&session);
    drop(session);
    drop(manager.resume(2));
    let session = manager.resume(3);
    send(&session, &declared(0));
    drop(session);
    // HELLO is refused: the node closes the connection and tries again.
    for _ in 0..3 {
        let session = manager.accept();
        assert!(matches!(
            manager.read(&session),
            ToManager::Hello { resuming: true, .. }
        ));
        let reason = Refusal::NameTaken;
        send(&session, &ToNode::HelloRefused { reason });
        assert_eq!(manager.try_read(&session), None);
        carries(&publisher, &peer);
    }
    let _session = manager.adopt(6);
    carries(&publisher, &peer);
}

//= SM2-RES-010 test
#[test]
fn a_declaration_that_is_refused_is_renewed_in_the_next_session() {
    let (manager, publisher, peer) = Manager::with_linked_node();
    let session = manager.resume(2);
    let refused = ToNode::DeclareRefused {
        interface: INTERFACE,
        reason: Refusal::TopicType {
            theirs: sm2_node::TypeId {
                name: Name::new("other").unwrap(),
                hash: 1,
            },
        },
    };
    send(&session, &refused);
    assert_eq!(
        manager.read(&session),
        ToManager::Claimed,
        "no link is claimed for the refused interface"
    );
    manager
        .node
        .as_ref()
        .unwrap()
        .wait_connected_timeout(SOON)
        .unwrap();
    assert!(!publisher.is_registered());
    carries(&publisher, &peer);
    drop(session);
    let _session = manager.adopt(3);
    assert!(publisher.is_registered());
    carries(&publisher, &peer);
}

/// A node whose session ended, although its Manager still runs, has lost its links: the Manager has ended
/// their other sides.
//= SM2-RES-002, SM2-SES-006 test
#[test]
fn links_of_the_manager_that_is_still_there_are_not_claimed() {
    let (manager, publisher, peer) = Manager::with_linked_node();
    let session = manager.resume(1);
    send(&session, &declared(0));
    assert_eq!(manager.read(&session), ToManager::Claimed);
    drop(peer);
    until(|| publisher.links()[0].end.is_some());
    drop(publisher);
    let interface = INTERFACE;
    let next = manager.read(&session);
    assert_eq!(next, ToManager::Withdraw { interface }, "and no UNLINKED");
}

/// If a Manager ends just after a node has connected, or finds the greeting too late, the node connects again. If a
/// Manager refuses the node, it does not.
#[test]
fn a_node_that_was_never_welcomed_tries_again_unless_it_was_refused() {
    let (manager, path) = Manager::listening();
    let connect = || {
        let builder = builder(path.clone());
        std::thread::spawn(move || builder.connect())
    };
    let goodbye = |farewell: Farewell| ToNode::Goodbye {
        code: farewell.code(),
    };
    let connecting = connect();
    let hello = ToManager::Hello {
        min_version: 1,
        max_version: 1,
        name: Name::new("node").unwrap(),
        resuming: false,
    };
    let late = goodbye(Farewell::GreetingTimeout);
    for last in [None, Some(goodbye(Farewell::ShuttingDown)), Some(late)] {
        let session = manager.accept();
        assert_eq!(manager.read(&session), hello);
        last.iter().for_each(|frame| send(&session, frame));
    }
    let session = manager.accept();
    assert_eq!(manager.read(&session), hello);
    welcome(&session, 1);
    let node = connecting.join().unwrap().unwrap();
    assert_eq!(node.epoch(), Some(1));
    drop((node, session));
    let wrong = [
        (goodbye(Farewell::Stalled), "stalled"),
        (declared(0), "expected-welcome"),
    ];
    for (frame, told) in wrong {
        let connecting = connect();
        let session = manager.accept();
        manager.read(&session);
        send(&session, &frame);
        let error = connecting.join().unwrap().unwrap_err();
        assert!(matches!(error, ConnectError::Ended(_)), "{error}");
        assert!(error.to_string().contains(told), "{error}");
    }
}

/// A Manager that has no descriptors for a link announces the link in DECLARED and never sends it. A call then
/// has no server.
//= SM2-IFC-002 test
#[test]
fn a_call_does_not_wait_for_a_link_that_was_announced_and_never_comes() {
    let (manager, path) = Manager::listening();
    let (result, called) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let node = builder(path).connect().unwrap();
        let client = node.client::<u8, u8>("service").unwrap();
        let _ = result.send(client.call(&1).map(drop));
    });
    let session = manager.accept();
    assert!(matches!(manager.read(&session), ToManager::Hello { .. }));
    welcome(&session, 1);
    assert!(matches!(manager.read(&session), ToManager::Declare { .. }));
    send(&session, &declared(1));
    // The answer to a request that follows DECLARE comes after the LINKs that DECLARED announced.
    let request = manager.read(&session);
    assert!(matches!(request, ToManager::Query { .. }), "{request:?}");
    let page = ToNode::Page(Page {
        revision: 1,
        items: Vec::new(),
        next: None,
    });
    send(&session, &page);
    let result = called.recv_timeout(SOON).expect("the call ends");
    assert!(matches!(result, Err(CallError::NoServer { .. })));
}

//= SM2-LNK-009, SM2-LNK-005 test
#[test]
fn unlinked_tells_how_the_link_ended() {
    let (close, open) = ([9, 0, 42, 0, 0, 0, 0, 0], open());
    let violation = sm2_proto::ViolationKind::UnexpectedOpen.code().0;
    let ends: [(&[u8], u16); 3] = [(&close, 42), (&[], 5), (&open, violation)];
    for (last, expected) in ends {
        let (manager, _publisher, ours) = Manager::with_linked_node();
        let session = manager.adopt(2);
        // An empty frame is not sent: the stream only ends.
        let _ = ours.send(&[IoSlice::new(last)], &[]);
        drop(ours);
        let frame = manager.read(&session);
        let code = |it: &_| matches!(it, ToManager::Unlinked { code, .. } if code.0 == expected);
        assert!(code(&frame), "{frame:?}");
    }
}
