//! The two ends of a link under test: the real interface, and the raw end that breaks a rule.

use std::{
    cell::RefCell,
    os::fd::{AsFd, OwnedFd},
    rc::Rc,
};

use sm2_proto::ViolationKind;

use crate::{
    actor::Actor,
    control::{self, Qos},
    link::{Open, inline, kind, role},
    raw::RawLink,
    violations::Row,
};

/// The real end of a link: an interface that the victim declares again for each row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Real {
    /// A reliable subscriber that takes messages only on command: window 6.
    Subscriber,
    /// The same, whose links are sealed.
    SealedSubscriber,
    /// A best-effort subscriber that takes messages of up to 1,024 bytes, only on command: window 6.
    BestEffort,
    /// As `BestEffort`, of a publisher whose messages expire after a minute.
    Expiring,
    /// A publisher with depth 8.
    Publisher,
    /// A reliable publisher that does not wait for subscribers.
    ReliablePublisher,
    /// A server that takes requests only on command: window 6.
    Server,
    /// A server with room for 2,048 requests.
    WideServer,
    /// A client.
    Client,
}

/// The window that [`Real::Subscriber`], [`Real::Server`] and [`Real::Client`] announce.
pub const WINDOW: u64 = 6;

impl Real {
    /// The command that declares it, as `x`.
    #[must_use]
    pub const fn command(self) -> &'static str {
        match self {
            Self::Subscriber => "sub x x depth=4 borrow=2 reliable",
            Self::SealedSubscriber => "sub x x depth=4 borrow=2 reliable sealed",
            Self::BestEffort | Self::Expiring => "sub x x depth=4 borrow=2 max_len=1024",
            Self::Publisher => "pub x x depth=8",
            Self::ReliablePublisher => "pub x x depth=8 reliable_ms=0",
            Self::Server => "server x x depth=4 borrow=2",
            Self::WideServer => "server x x depth=1024 borrow=1024",
            Self::Client => "client x x borrow=5",
        }
    }

    /// The declaration of the raw node that is linked with it.
    #[must_use]
    pub fn counterpart(self) -> Vec<u8> {
        match self {
            Self::Subscriber | Self::SealedSubscriber | Self::BestEffort => {
                control::publisher("x", Qos::RELIABLE)
            }
            Self::Expiring => control::publisher(
                "x",
                Qos {
                    lifespan: 60_000_000_000,
                    ..Qos::PLAIN
                },
            ),
            Self::Publisher => control::subscriber("x", Qos::PLAIN),
            Self::ReliablePublisher => control::subscriber("x", Qos::RELIABLE),
            Self::Server | Self::WideServer => control::client("x", Qos::PLAIN),
            Self::Client => control::server("x", Qos::PLAIN),
        }
    }

    /// The role of the raw end, and the window that it announces.
    #[must_use]
    pub const fn raw_role(self) -> (u8, u32) {
        match self {
            Self::Subscriber | Self::SealedSubscriber | Self::BestEffort | Self::Expiring => {
                (role::SENDER, 0)
            }
            Self::Publisher | Self::ReliablePublisher => (role::RECEIVER, 6),
            Self::Server | Self::WideServer => (role::CALLER, 6),
            Self::Client => (role::SERVER, 6),
        }
    }

    /// The role and window that the real end must send in OPEN.
    #[must_use]
    pub const fn real_role(self) -> (u8, u32) {
        match self {
            Self::Subscriber | Self::SealedSubscriber | Self::BestEffort | Self::Expiring => {
                (role::RECEIVER, 6)
            }
            Self::Publisher | Self::ReliablePublisher => (role::SENDER, 0),
            Self::Server => (role::SERVER, 6),
            Self::WideServer => (role::SERVER, 2048),
            Self::Client => (role::CALLER, 6),
        }
    }

    /// The kind of message that it receives; a publisher receives none.
    #[must_use]
    pub const fn receives(self) -> u8 {
        match self {
            Self::Subscriber | Self::SealedSubscriber | Self::BestEffort | Self::Expiring => {
                kind::DATA
            }
            Self::Server | Self::WideServer => kind::REQUEST,
            Self::Client | Self::Publisher | Self::ReliablePublisher => kind::REPLY,
        }
    }

    /// Whether it offers the ring lane.
    #[must_use]
    pub const fn offers_ring(self) -> bool {
        !matches!(self, Self::SealedSubscriber)
    }
}

/// A new link, and the node of its real end.
pub struct LinkStage {
    /// The raw end; neither side's OPEN has been read.
    pub link: RawLink,
    /// The real end.
    pub real: Real,
    /// The node of the real end.
    pub victim: Rc<RefCell<Actor>>,
}

impl LinkStage {
    /// Sends a datagram.
    pub fn send(&self, bytes: impl AsRef<[u8]>) {
        self.link.end.send(bytes);
    }

    /// Sends a datagram with a descriptor.
    pub fn send_fd(&self, bytes: impl AsRef<[u8]>, fd: &OwnedFd) {
        self.link.end.send_fds(bytes, &[fd.as_fd()]);
    }

    /// The OPEN of the raw end.
    #[must_use]
    pub fn greeting(&self) -> Open {
        let (role, window) = self.real.raw_role();
        Open::new(role, self.link.id, window)
    }

    /// Both sides send OPEN. The raw end does not offer the ring lane, so it uses no RING of the real end.
    pub fn open(&self) {
        self.send(self.greeting().bytes());
        self.expect_open();
        let (_, window) = self.real.real_role();
        if self.real.offers_ring() && window > 0 {
            assert_eq!(self.link.end.expect().bytes[0], kind::RING, "RING");
        }
    }

    /// Receives and checks the OPEN of the real end.
    pub(super) fn expect_open(&self) {
        let (end, window) = self.real.real_role();
        let mut theirs = Open::new(end, self.link.id, window);
        if matches!(self.real, Real::BestEffort | Real::Expiring) {
            theirs.max_len = 1;
        }
        if self.real.offers_ring() {
            theirs = theirs.with_ring();
        }
        let came = self.link.end.expect().bytes;
        if end == role::SENDER {
            theirs.publisher = u64::from_le_bytes(came[32..40].try_into().expect("8 bytes"));
            assert_ne!(theirs.publisher, 0, "a publisher says who it is");
        }
        assert_eq!(came, theirs.bytes(), "the real end's OPEN");
    }

    /// Opens, and sends the first messages of the kind that the real end receives.
    pub fn messages(&self, count: u64) {
        self.open();
        for n in 1..=count {
            self.send(inline(self.real.receives(), n, b"payload"));
        }
    }

    /// Opens, and has the publisher send `count` messages.
    pub fn published(&self, count: u64) {
        self.open();
        self.victim.borrow_mut().tell("wait x 1");
        let command = format!("publish x {count} 8");
        self.victim.borrow_mut().tell(&command);
        for n in 1..=count {
            let head = self.link.end.expect().bytes;
            assert_eq!((head[0], head[16]), (kind::DATA, n as u8), "DATA");
        }
    }

    /// Opens, and has the client call; the call's number.
    pub fn called(&self) -> u64 {
        self.open();
        self.victim.borrow_mut().tell("wait x 1");
        self.victim.borrow_mut().tell("call x 8");
        let head = self.link.end.expect().bytes;
        assert_eq!(head[0], kind::REQUEST, "REQUEST");
        u64::from_le_bytes(head[24..32].try_into().expect("8 bytes"))
    }
}

/// A row, and the real end that it is run against.
pub struct LinkRow {
    /// The real end, which must find the violation.
    pub real: Real,
    /// The violation.
    pub row: Row<LinkStage>,
}

pub(super) type Rows = Vec<LinkRow>;

/// A builder for the rows of one rule.
pub(super) struct Rule {
    violation: ViolationKind,
    clause: &'static str,
    rows: Rows,
}

impl Rule {
    pub(super) const fn new(violation: ViolationKind, clause: &'static str) -> Self {
        let rows = Rows::new();
        Self {
            violation,
            clause,
            rows,
        }
    }

    /// A row on a link without any frame so far.
    pub(super) fn fresh(
        mut self,
        real: Real,
        what: impl Into<String>,
        commit: impl Fn(&LinkStage) + 'static,
    ) -> Self {
        let Self {
            violation, clause, ..
        } = self;
        let (what, commit) = (what.into(), Box::new(commit));
        let row = Row {
            violation,
            clause,
            what,
            commit,
        };
        self.rows.push(LinkRow { real, row });
        self
    }

    /// A row on an open link.
    pub(super) fn open(
        self,
        real: Real,
        what: impl Into<String>,
        commit: impl Fn(&LinkStage) + 'static,
    ) -> Self {
        self.fresh(real, what, move |stage| {
            stage.open();
            commit(stage);
        })
    }

    /// A row that sends one datagram on an open link.
    pub(super) fn sent(
        self,
        real: Real,
        what: impl Into<String>,
        bytes: impl Into<Vec<u8>>,
    ) -> Self {
        let bytes = bytes.into();
        self.open(real, what, move |stage| stage.send(&bytes))
    }
}

impl IntoIterator for Rule {
    type Item = LinkRow;
    type IntoIter = std::vec::IntoIter<Self::Item>;

    fn into_iter(self) -> Self::IntoIter {
        self.rows.into_iter()
    }
}

/// The rows of several rules.
pub(super) fn all<const N: usize>(rules: [Rule; N]) -> Rows {
    rules.into_iter().flatten().collect()
}
