//! Violations by a Manager towards a node.

use std::{
    cell::{Cell, RefCell},
    os::fd::AsFd,
};

use sm2_io::SeqPacket;
use sm2_proto::{
    LinkId,
    ViolationKind::{
        BadLink, BadLinkId, BadName, BadQos, BadSchema, BadVersion, ExpectedWelcome, FdCount,
        FrameTooLong, Malformed, NotCanonical, TrailingBytes, UnexpectedChanges,
        UnexpectedCounters, UnexpectedPage, UnexpectedReloaded, UnexpectedSchema,
        UnexpectedWelcome, UnknownFrame, UnknownInterface, UnknownLink,
    },
};

use super::Row;
use crate::{
    actor::Actor,
    control::{
        self, Qos, bytes_type, publisher, subscriber,
        to_node::{
            Link, changes, declare_refused, declared, described, goodbye, hello_refused, inspected,
            node_item, not_inspected, page, reloaded, unlink, welcome, withdrawn,
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
    /// True if the first of them is open, and will outlive the session.
    pub linked: Cell<bool>,
    /// True if the node waits for an answer, which will be an error.
    pub waiting: Cell<bool>,
    /// True if that is the answer to a declaration. Its error comes only when no Manager has taken over in time.
    pub declaring: Cell<bool>,
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
            declaring: Cell::new(false),
        }
    }

    fn send(&self, bytes: impl AsRef<[u8]>) {
        self.session.send(bytes);
    }

    /// The next frame of the node, without those that come at any time: its counters, and how many links it can
    /// have.
    fn expect(&self) -> Vec<u8> {
        loop {
            let bytes = self.session.expect().bytes;
            if bytes != control::counters() && bytes[0] != control::MAX_LINKS {
                return bytes;
            }
        }
    }

    /// Welcomes the node.
    fn ready(&self) {
        self.send(welcome(1, 9, 1));
        assert_eq!(self.actor.borrow().answer(), "ready");
        self.waiting.set(false);
    }

    /// Makes the node declare a subscriber, which is not answered yet.
    fn declare(&self, options: &str) {
        self.ready();
        let mut actor = self.actor.borrow_mut();
        actor.say(&format!("sub t t {options}"));
        assert_eq!(self.expect()[..2], [1, SUBSCRIBER as u8], "DECLARE");
        self.waiting.set(true);
        self.declaring.set(true);
    }

    /// Makes the node declare a subscriber, and grants it.
    fn live(&self, options: &str) {
        self.declare(options);
        self.send(declared(SUBSCRIBER, 0));
        assert!(self.actor.borrow().answer().starts_with("ok"));
        self.waiting.set(false);
        self.declaring.set(false);
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

/// A LINK that is legal for the subscriber.
fn link() -> Link {
    Link {
        interface: SUBSCRIBER,
        link: LINK,
        key: 5,
        version: 1,
        reliable: false,
        sealed: false,
        contract: publisher("t", Qos::PLAIN),
    }
}

type Rows = Vec<Row<NodeStage>>;
type Rule = super::Rule<NodeStage>;

impl Rule {
    /// A frame to a node that has not been welcomed.
    fn greeting(self, what: impl Into<String>, bytes: Vec<u8>) -> Self {
        self.row(what, move |stage| stage.send(&bytes))
    }

    /// A frame to a node with an interface that is being declared.
    fn declaring(self, what: impl Into<String>, bytes: Vec<u8>) -> Self {
        self.row(what, move |stage| {
            stage.declare("");
            stage.send(&bytes);
        })
    }

    /// A frame to a node with a link.
    fn linked(self, what: impl Into<String>, bytes: impl Into<Vec<u8>>) -> Self {
        let bytes = bytes.into();
        self.row(what, move |stage| {
            stage.linked();
            stage.send(&bytes);
        })
    }

    /// LINK to a node whose subscriber has these options.
    fn link(self, what: &str, options: &'static str, link: Link) -> Self {
        self.row(format!("LINK {what}"), move |stage| {
            stage.live(options);
            stage.send_link(&link);
        })
    }
}

/// The rows of several rules.
fn all<const N: usize>(rules: [Rule; N]) -> Rows {
    rules.into_iter().flatten().collect()
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
    let what = "LINK with more descriptors than the node can take";
    all([Rule::new(FdCount, "SM2-TRN-010").row(what, |stage| {
        stage.live("");
        let nulls: Vec<_> = (0..200).map(|_| memory::null()).collect();
        let fds: Vec<_> = nulls.iter().map(AsFd::as_fd).collect();
        stage.session.send_fds(link().bytes(), &fds);
    })])
}

fn transport() -> Rows {
    let long = Rule::new(FrameTooLong, "SM2-TRN-004").linked("65,537 bytes", [0; 65_537]);
    let count = Rule::new(FdCount, "SM2-TRN-010")
        .row("WELCOME with a descriptor", |stage| {
            let null = memory::null();
            stage.session.send_fds(welcome(1, 9, 1), &[null.as_fd()]);
        })
        .row("LINK without a descriptor", |stage| {
            stage.live("");
            stage.send(link().bytes());
        })
        .row("LINK with two", |stage| {
            stage.live("");
            let (one, two) = SeqPacket::pair().expect("a socket pair");
            let fds = [one.as_fd(), two.as_fd()];
            stage.session.send_fds(link().bytes(), &fds);
        })
        .row("GOODBYE with one", |stage| {
            stage.linked();
            let null = memory::null();
            stage.session.send_fds(goodbye(0), &[null.as_fd()]);
        });
    all([long, count])
}

fn encoding() -> Rows {
    let long = page(&[node_item("x".repeat(256))]);
    let with = |contract| Link { contract, ..link() };
    let topic = with(publisher("a//b", Qos::PLAIN));
    let mut qos = Qos::PLAIN;
    qos.depth = 0;
    let depth = with(publisher("t", qos));
    all([
        Rule::new(UnknownFrame, "SM2-FRM-001").linked("frame 15", [15]),
        Rule::new(Malformed, "SM2-FRM-001")
            .linked("DECLARED without fields", [2])
            .linked("HELLO_REFUSED for reason 5", [1, 5]),
        Rule::new(TrailingBytes, "SM2-FRM-001").linked("GOODBYE and a byte", [8, 0, 0]),
        Rule::new(NotCanonical, "SM2-FRM-002").linked("GOODBYE with 0 in two bytes", [8, 0x80, 0]),
        Rule::new(BadName, "SM2-NAM-001")
            .linked("PAGE with a long name", long)
            .link("with a bad topic", "", topic),
        Rule::new(BadQos, "SM2-FRM-003").link("with depth 0", "", depth),
    ])
}

fn greeting() -> Rows {
    let expected = Rule::new(ExpectedWelcome, "SM2-NOD-001")
        .greeting("DECLARED before WELCOME", declared(1, 0))
        .greeting(
            "DECLARE_REFUSED before WELCOME",
            declare_refused(1, &bytes_type()),
        )
        .greeting("UNLINK before WELCOME", unlink(1, LINK, 0))
        .greeting("WITHDRAWN before WELCOME", withdrawn(1))
        .greeting("PAGE before WELCOME", page(&[]))
        .greeting("CHANGES before WELCOME", changes(1))
        .greeting("NOT_INSPECTED before WELCOME", not_inspected(1))
        .greeting("DESCRIBED before WELCOME", described(&bytes_type(), None))
        .greeting("RELOADED before WELCOME", reloaded())
        .row("LINK before WELCOME", |stage| stage.send_link(&link()));
    let unexpected = Rule::new(UnexpectedWelcome, "SM2-NOD-001")
        .linked("WELCOME after WELCOME", welcome(1, 9, 1))
        .linked("HELLO_REFUSED after WELCOME", hello_refused());
    let version = Rule::new(BadVersion, "SM2-NOD-002")
        .greeting("WELCOME with version 0", welcome(0, 9, 1))
        .greeting("WELCOME with version 2", welcome(2, 9, 1));
    all([expected, unexpected, version])
}

fn interfaces() -> Rows {
    let refused = |interface| declare_refused(interface, &bytes_type());
    let answers = Rule::new(UnknownInterface, "SM2-IFC-002")
        .linked("DECLARED for none", declared(7, 0))
        .linked("DECLARE_REFUSED for none", refused(7))
        .linked("DECLARED for a live one", declared(SUBSCRIBER, 0))
        .linked("DECLARE_REFUSED for a live one", refused(SUBSCRIBER))
        .declaring(
            "DECLARED for another than was declared",
            declared(SUBSCRIBER + 1, 0),
        );
    let withdrawals = Rule::new(UnknownInterface, "SM2-IFC-003")
        .linked("WITHDRAWN for none", withdrawn(7))
        .linked("WITHDRAWN for a live one", withdrawn(SUBSCRIBER))
        .declaring(
            "WITHDRAWN for one that is being declared",
            withdrawn(SUBSCRIBER),
        );
    let unlinks = Rule::new(UnknownInterface, "SM2-LNK-003")
        .linked("UNLINK for none", unlink(7, LINK, 0))
        .declaring(
            "UNLINK for one that is being declared",
            unlink(SUBSCRIBER, LINK, 0),
        );
    let pages = Rule::new(UnexpectedPage, "SM2-IFC-007").linked("PAGE without a QUERY", page(&[]));
    let watched =
        Rule::new(UnexpectedChanges, "SM2-WCH-001").linked("CHANGES without a WATCH", changes(2));
    let counters = Rule::new(UnexpectedCounters, "SM2-CNT-003")
        .linked("NOT_INSPECTED without an INSPECT", not_inspected(1))
        .row("INSPECTED without an INSPECT", |stage| {
            stage.linked();
            let file = memory::segment(1_024);
            stage.session.send_fds(inspected(1), &[file.as_fd()]);
        });
    let lost = Rule::new(UnexpectedCounters, "SM2-CNT-002").row(
        "COUNTERS_LOST without COUNTERS",
        |stage| {
            stage.ready();
            stage.send([13]);
        },
    );
    let schemas = Rule::new(UnexpectedSchema, "SM2-SCH-002").linked(
        "DESCRIBED without a DESCRIBE",
        described(&bytes_type(), None),
    );
    let texts = Rule::new(BadSchema, "SM2-SCH-002").row(
        "DESCRIBED with the text of another type",
        |stage| {
            stage.linked();
            stage.actor.borrow_mut().say("describe t 1");
            let asked = control::describe(&control::type_id("t", 1));
            assert_eq!(stage.expect(), asked);
            let data = control::type_id("t", 1);
            stage.send(described(&data, Some("plain:u8")));
            stage.waiting.set(true);
        },
    );
    let policies = Rule::new(UnexpectedReloaded, "SM2-ACC-016")
        .linked("RELOADED without a RELOAD", reloaded());
    let interfaces = all([answers, withdrawals, unlinks]);
    let asked = all([pages, watched, counters, lost, schemas, texts, policies]);
    [interfaces, asked].into_iter().flatten().collect()
}

fn links() -> Rows {
    let other = LinkId { serial: 2, ..LINK };
    let unknown = Rule::new(UnknownLink, "SM2-LNK-003")
        .linked("UNLINK of no link", unlink(SUBSCRIBER, other, 0))
        .row("UNLINK twice", move |stage| {
            stage.linked();
            let link = Link {
                link: other,
                ..link()
            };
            stage.send_link(&link);
            stage.send(unlink(SUBSCRIBER, other, 0));
            let answer = stage.expect();
            assert_eq!(answer[..2], [3, SUBSCRIBER as u8], "UNLINKED");
            stage.send(unlink(SUBSCRIBER, other, 0));
        });
    let twice = Rule::new(BadLinkId, "SM2-LNK-004").row("LINK twice", |stage| {
        stage.linked();
        stage.send_link(&link());
    });
    let interface = Rule::new(UnknownInterface, "SM2-LNK-004")
        .row("LINK for an interface that the node never had", |stage| {
            stage.linked();
            let interface = 7;
            stage.send_link(&Link {
                interface,
                ..link()
            });
        })
        .row("LINK for an interface that is being declared", |stage| {
            stage.declare("");
            stage.send_link(&link());
        });
    all([unknown, twice, interface])
}

fn bad_links() -> Rows {
    let with = |contract| Link { contract, ..link() };
    let plain = with(publisher("t", Qos::PLAIN));
    let willing = with(publisher("t", Qos::RELIABLE));
    let typed = control::typed_publisher("t", &control::type_id("other", 1), Qos::PLAIN);
    let reliable = |link| Link {
        reliable: true,
        ..link
    };
    let newer = Link {
        version: 2,
        ..link()
    };
    let rule = Rule::new(BadLink, "SM2-LNK-004")
        .link(
            "whose peer subscribes too",
            "",
            with(subscriber("t", Qos::PLAIN)),
        )
        .link("of another topic", "", with(publisher("u", Qos::PLAIN)))
        .link("of another type", "", with(typed))
        .link("for version 2", "", newer)
        .link(
            "that is not reliable as demanded",
            "reliable",
            willing.clone(),
        )
        .link(
            "that is reliable and cannot be",
            "reliable",
            reliable(plain.clone()),
        )
        .link("that is reliable undemanded", "", reliable(willing))
        .link(
            "whose peer does not offer the deadline",
            "deadline",
            plain.clone(),
        )
        .link(
            "whose peer does not offer the lease",
            "liveliness",
            plain.clone(),
        )
        .link("that is not sealed as demanded", "sealed", plain);
    all([rule])
}
