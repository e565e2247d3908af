//! What a Manager can do wrong towards a node.

use std::{
    cell::{Cell, RefCell},
    os::fd::AsFd,
};

use sm2_io::SeqPacket;
use sm2_proto::{LinkId, Violation};

use super::Row;
use crate::{
    actor::Actor,
    control::{
        self, Qos, bytes_type, publisher, subscriber,
        to_node::{
            Link, declare_refused, declared, goodbye, hello_refused, node_item, page, unlink,
            welcome, withdrawn,
        },
    },
    memory,
    raw::RawPeer,
};

/// A raw Manager and the node that has connected to it and sent HELLO.
pub struct NodeStage {
    /// The Manager's end of the session.
    pub session: RawPeer,
    /// The node.
    pub actor: RefCell<Actor>,
    /// Our ends of the links that the node was given.
    pub links: RefCell<Vec<RawPeer>>,
    /// Whether the first of them is open, and will outlive the session.
    pub linked: Cell<bool>,
    /// Whether the node waits for an answer, which will be an error.
    pub waiting: Cell<bool>,
}

/// The interface that [`NodeStage::declare`] makes.
const SUBSCRIBER: u64 = 1;

const LINK: LinkId = LinkId {
    epoch: 9,
    serial: 1,
};

impl NodeStage {
    /// The session of a node that has just greeted.
    #[must_use]
    pub const fn new(session: RawPeer, actor: Actor) -> Self {
        Self {
            session,
            actor: RefCell::new(actor),
            links: RefCell::new(Vec::new()),
            linked: Cell::new(false),
            waiting: Cell::new(true),
        }
    }

    fn send(&self, bytes: impl AsRef<[u8]>) {
        self.session.send(bytes);
    }

    /// Welcomes the node.
    fn ready(&self) {
        self.send(welcome(1, 9, 1));
        assert_eq!(self.actor.borrow().answer(), "ready");
        self.waiting.set(false);
    }

    /// Has the node declare a subscriber, which is not answered yet.
    fn declare(&self, options: &str) {
        self.ready();
        let mut actor = self.actor.borrow_mut();
        actor.say(&format!("sub t t {options}"));
        let frame = self.session.expect();
        assert_eq!(frame.bytes[..2], [1, SUBSCRIBER as u8], "DECLARE");
        self.waiting.set(true);
    }

    /// Has the node declare a subscriber, and grants it.
    fn live(&self, options: &str) {
        self.declare(options);
        self.send(declared(SUBSCRIBER, 0));
        assert!(self.actor.borrow().answer().starts_with("ok"));
        self.waiting.set(false);
    }

    /// LINK with one end of a new link; the other end is ours.
    fn send_link(&self, link: &Link) {
        let (ours, theirs) = SeqPacket::pair().expect("a socket pair");
        self.session.send_fds(link.bytes(), &[theirs.as_fd()]);
        self.links.borrow_mut().push(RawPeer::new(ours));
    }

    /// A live subscriber with one open link.
    fn linked(&self) {
        self.live("");
        self.send_link(&link());
        let open = crate::link::Open::new(crate::link::role::SENDER, LINK, 0);
        let links = self.links.borrow();
        links[0].send(open.bytes());
        assert_eq!(links[0].expect().bytes[0], crate::link::kind::OPEN);
        self.linked.set(true);
    }
}

/// What a Manager may say of the subscriber's link.
fn link() -> Link {
    Link {
        interface: SUBSCRIBER,
        link: LINK,
        version: 1,
        reliable: false,
        sealed: false,
        contract: publisher("t", Qos::PLAIN),
    }
}

type Rows = Vec<Row<NodeStage>>;

fn row(
    violation: Violation,
    clause: &'static str,
    what: impl Into<String>,
    commit: impl Fn(&NodeStage) + 'static,
) -> Row<NodeStage> {
    Row::new(violation, clause, what, commit)
}

/// The rows; each starts with a node that has sent HELLO.
#[must_use]
pub fn rows() -> Rows {
    let mut rows = transport();
    rows.extend(encoding());
    rows.extend(greeting());
    rows.extend(interfaces());
    rows.extend(links());
    rows.extend(bad_links());
    rows
}

/// The rows for a node that has few descriptors to spare.
#[must_use]
pub fn starved_rows() -> Rows {
    use Violation::ControlTruncated;
    let what = "LINK with more descriptors than the node can take";
    vec![row(ControlTruncated, "SM2-TRN-005", what, |stage| {
        stage.live("");
        let nulls: Vec<_> = (0..200).map(|_| memory::null()).collect();
        let fds: Vec<_> = nulls.iter().map(AsFd::as_fd).collect();
        stage.session.send_fds(link().bytes(), &fds);
    })]
}

fn transport() -> Rows {
    use Violation::{FdCount, FrameTooLong};
    vec![
        row(FrameTooLong, "SM2-TRN-004", "65,537 bytes", |stage| {
            stage.ready();
            stage.send([0; 65_537]);
        }),
        row(
            FdCount,
            "SM2-TRN-005",
            "WELCOME with a descriptor",
            |stage| {
                let null = memory::null();
                stage.session.send_fds(welcome(1, 9, 1), &[null.as_fd()]);
            },
        ),
        row(
            FdCount,
            "SM2-TRN-005",
            "LINK without a descriptor",
            |stage| {
                stage.live("");
                stage.send(link().bytes());
            },
        ),
        row(FdCount, "SM2-TRN-005", "LINK with two", |stage| {
            stage.live("");
            let (one, two) = SeqPacket::pair().expect("a socket pair");
            let fds = [one.as_fd(), two.as_fd()];
            stage.session.send_fds(link().bytes(), &fds);
        }),
        row(FdCount, "SM2-TRN-005", "GOODBYE with one", |stage| {
            stage.linked();
            let null = memory::null();
            stage.session.send_fds(goodbye(0), &[null.as_fd()]);
        }),
    ]
}

fn encoding() -> Rows {
    use Violation::{BadName, BadQos, Malformed, NotCanonical, TrailingBytes, UnknownFrame};
    let long = "x".repeat(256);
    let bad_qos = Link {
        contract: publisher(
            "t",
            Qos {
                depth: 0,
                ..Qos::PLAIN
            },
        ),
        ..link()
    };
    let bad_topic = Link {
        contract: publisher("a//b", Qos::PLAIN),
        ..link()
    };
    let datagrams: Vec<(Violation, &str, &str, Vec<u8>)> = vec![
        (UnknownFrame, "SM2-FRM-001", "frame 9", vec![9]),
        (Malformed, "SM2-FRM-001", "DECLARED without fields", vec![2]),
        (Malformed, "SM2-FRM-001", "refusal 5", vec![1, 5]),
        (
            TrailingBytes,
            "SM2-FRM-001",
            "GOODBYE and a byte",
            vec![8, 0, 0],
        ),
        (
            NotCanonical,
            "SM2-FRM-002",
            "GOODBYE with 0 in two bytes",
            vec![8, 0x80, 0],
        ),
        (
            BadName,
            "SM2-NAM-001",
            "PAGE with a long name",
            page(&[node_item(long)]),
        ),
        (
            BadName,
            "SM2-NAM-001",
            "LINK with a bad topic",
            bad_topic.bytes(),
        ),
        (BadQos, "SM2-FRM-003", "LINK with depth 0", bad_qos.bytes()),
    ];
    let to_row = |(violation, clause, what, bytes): (_, _, &str, Vec<u8>)| {
        row(violation, clause, what, move |stage| {
            stage.linked();
            if bytes[0] == 4 {
                let null = memory::null();
                stage.session.send_fds(&bytes, &[null.as_fd()]);
            } else {
                stage.send(&bytes);
            }
        })
    };
    datagrams.into_iter().map(to_row).collect()
}

fn greeting() -> Rows {
    use Violation::{BadVersion, ExpectedWelcome, UnexpectedWelcome};
    let early = [
        ("DECLARED", declared(1, 0)),
        ("DECLARE_REFUSED", declare_refused(1, &bytes_type())),
        ("UNLINK", unlink(1, LINK, 0)),
        ("WITHDRAWN", withdrawn(1)),
        ("PAGE", page(&[])),
    ];
    let mut rows = Rows::new();
    for (frame, bytes) in early {
        let what = format!("{frame} before WELCOME");
        rows.push(row(ExpectedWelcome, "section 4.2", what, move |stage| {
            stage.send(&bytes);
        }));
    }
    rows.push(row(
        ExpectedWelcome,
        "section 4.2",
        "LINK before WELCOME",
        |stage| stage.send_link(&link()),
    ));
    for (frame, bytes) in [
        ("WELCOME", welcome(1, 9, 1)),
        ("HELLO_REFUSED", hello_refused()),
    ] {
        let what = format!("{frame} after WELCOME");
        rows.push(row(UnexpectedWelcome, "section 4.2", what, move |stage| {
            stage.linked();
            stage.send(&bytes);
        }));
    }
    for version in [0, 2] {
        let what = format!("WELCOME with version {version}");
        rows.push(row(BadVersion, "SM2-NOD-002", what, move |stage| {
            stage.send(welcome(version, 9, 1));
        }));
    }
    rows
}

fn interfaces() -> Rows {
    use Violation::{UnexpectedPage, UnknownInterface};
    let of_nobody = [
        ("DECLARED", declared(7, 0)),
        ("DECLARE_REFUSED", declare_refused(7, &bytes_type())),
        ("WITHDRAWN", withdrawn(7)),
        ("UNLINK", unlink(7, LINK, 0)),
    ];
    let of_live = [
        ("DECLARED", declared(SUBSCRIBER, 0)),
        (
            "DECLARE_REFUSED",
            declare_refused(SUBSCRIBER, &bytes_type()),
        ),
        ("WITHDRAWN", withdrawn(SUBSCRIBER)),
    ];
    let of_declaring = [
        ("UNLINK", unlink(SUBSCRIBER, LINK, 0)),
        ("WITHDRAWN", withdrawn(SUBSCRIBER)),
    ];
    let mut rows = Rows::new();
    for (frame, bytes) in of_nobody {
        let what = format!("{frame} for an interface that the node never had");
        rows.push(row(UnknownInterface, "section 4.3", what, move |stage| {
            stage.linked();
            stage.send(&bytes);
        }));
    }
    for (frame, bytes) in of_live {
        let what = format!("{frame} for a live interface");
        rows.push(row(UnknownInterface, "section 4.3", what, move |stage| {
            stage.linked();
            stage.send(&bytes);
        }));
    }
    for (frame, bytes) in of_declaring {
        let what = format!("{frame} for an interface that is being declared");
        rows.push(row(UnknownInterface, "section 4.3", what, move |stage| {
            stage.declare("");
            stage.send(&bytes);
        }));
    }
    let what = "DECLARED for another than was declared";
    rows.push(row(UnknownInterface, "SM2-IFC-002", what, |stage| {
        stage.declare("");
        stage.send(declared(SUBSCRIBER + 1, 0));
    }));
    let what = "PAGE without a QUERY";
    rows.push(row(UnexpectedPage, "SM2-IFC-007", what, |stage| {
        stage.linked();
        stage.send(page(&[]));
    }));
    rows
}

fn links() -> Rows {
    use Violation::{LinkNumber, UnknownInterface, UnknownLink};
    let other = LinkId { serial: 2, ..LINK };
    vec![
        row(
            UnknownLink,
            "SM2-LNK-003",
            "UNLINK of no link",
            move |stage| {
                stage.linked();
                stage.send(unlink(SUBSCRIBER, other, 0));
            },
        ),
        row(UnknownLink, "SM2-LNK-003", "UNLINK twice", move |stage| {
            stage.linked();
            stage.send_link(&Link {
                link: other,
                ..link()
            });
            stage.send(unlink(SUBSCRIBER, other, 0));
            let answer = stage.session.expect().bytes;
            assert_eq!(answer[..2], [3, SUBSCRIBER as u8], "UNLINKED");
            stage.send(unlink(SUBSCRIBER, other, 0));
        }),
        row(LinkNumber, "SM2-LNK-005", "LINK twice", |stage| {
            stage.linked();
            stage.send_link(&link());
        }),
        row(
            UnknownInterface,
            "SM2-LNK-005",
            "LINK for an interface that the node never had",
            |stage| {
                stage.linked();
                stage.send_link(&Link {
                    interface: 7,
                    ..link()
                });
            },
        ),
        row(
            UnknownInterface,
            "SM2-LNK-005",
            "LINK for an interface that is being declared",
            |stage| {
                stage.declare("");
                stage.send_link(&link());
            },
        ),
    ]
}

fn bad_links() -> Rows {
    let typed = control::typed_publisher("t", &control::type_id("other", 1), Qos::PLAIN);
    let with = |contract| Link { contract, ..link() };
    let links = [
        (
            "whose peer subscribes too",
            "",
            with(subscriber("t", Qos::PLAIN)),
        ),
        (
            "whose peer publishes another topic",
            "",
            with(publisher("u", Qos::PLAIN)),
        ),
        ("whose peer publishes another type", "", with(typed)),
        (
            "for version 2",
            "",
            Link {
                version: 2,
                ..link()
            },
        ),
        (
            "that is not reliable as demanded",
            "reliable",
            with(publisher("t", Qos::RELIABLE)),
        ),
        (
            "that is reliable although the publisher is not",
            "reliable",
            Link {
                reliable: true,
                ..link()
            },
        ),
        (
            "that is reliable undemanded",
            "",
            Link {
                reliable: true,
                ..with(publisher("t", Qos::RELIABLE))
            },
        ),
        ("that is not sealed as demanded", "sealed", link()),
    ];
    let to_row = |(what, options, link): (&str, &'static str, Link)| {
        let what = format!("LINK {what}");
        row(Violation::BadLink, "SM2-LNK-005", what, move |stage| {
            stage.live(options);
            stage.send_link(&link);
        })
    };
    links.into_iter().map(to_row).collect()
}
