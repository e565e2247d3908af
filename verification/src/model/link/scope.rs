//! The bounds of a search: the link, and the events that may happen.

use sm2_proto::{
    LinkId, Period,
    link::{Config, MaxLen, Publications, Role},
};

/// How often each event may happen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Budget {
    /// End 0 publishes, or calls.
    pub messages: u8,
    /// A reliable publisher's deadline passes while it waits.
    pub skips: u8,
    /// The caller cancels a call, which may have ended or been cancelled before.
    pub cancels: u8,
    /// An end retires a segment.
    pub retires: u8,
    /// A program closes its end.
    pub closes: u8,
    /// A process dies.
    pub deaths: u8,
}

/// Where the payload of a message is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Form {
    /// In the datagram.
    Inline,
    /// In a slot.
    Pooled,
    /// In a separate file.
    Sealed,
}

/// A deliberate fault, which the search must find. It happens whenever it is possible.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Fault {
    /// OPEN never arrives.
    OpenLost,
    /// OPEN arrives with a window that is larger by one.
    OtherWindow,
    /// ATTACH never arrives.
    AttachLost,
    /// DETACH never arrives.
    DetachLost,
    /// DATA never arrives.
    DataLost,
    /// DATA arrives twice, with the number and the id of the next one.
    DataAgain,
    /// DATA arrives before the DATA that was sent before it.
    DataOvertakes,
    /// DATA takes the place and the number of the DATA before it, if that was not read.
    DataReplaces,
    /// RELEASE never arrives.
    ReleaseLost,
    /// RELEASE arrives twice.
    ReleaseTwice,
    /// RELEASE arrives when a message was read, before it was released.
    ReleaseEarly,
    /// RELEASE states discarded for consumed, and the reverse.
    OtherFate,
    /// REPLY never arrives.
    ReplyLost,
    /// The REPLY to call 2 names call 1.
    OtherCall,
    /// CANCEL arrives twice.
    CancelTwice,
    /// Frames that were sent before the end of the stream are lost.
    EndOvertakes,
    /// A driver sends the packet that it kept, although its link has ended.
    KeptAfterEnd,
    /// A slot is written again although the link ended with its message.
    AbandonedReused,
    /// A machine panics at the end of the stream.
    Panics,
}

/// The kind of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkKind {
    /// A link of a topic: a publisher and a subscriber.
    Topic,
    /// A link of a service: a caller and a server.
    Service,
}

/// The moment when a search starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Neither end has sent OPEN.
    Connected,
    /// Both ends are open.
    Opened,
}

/// The bounds of one search.
#[derive(Clone, Debug)]
pub struct LinkScope {
    /// The name.
    pub name: &'static str,
    /// The kind of the link.
    pub kind: LinkKind,
    /// True if no message may be displaced.
    pub reliable: bool,
    /// True if pooled messages are illegal.
    pub sealed: bool,
    /// The depth of each end.
    pub depth: [u16; 2],
    /// The number of messages that each application may hold.
    pub max_borrowed: [u16; 2],
    /// The forms that messages may have.
    pub forms: &'static [Form],
    /// The number of segments of each end, and of slots in each segment.
    pub segments: u32,
    /// See `segments`.
    pub slots: u32,
    /// The number of unread packets that a socket holds.
    pub socket: usize,
    /// The limits of the numbers of events.
    pub budget: Budget,
    /// The moment when the search starts.
    pub start: Start,
    /// True if the search takes only seconds.
    pub quick: bool,
    /// The fault, if any.
    pub fault: Option<Fault>,
}

/// Size of a socket that is never full.
const ROOMY: usize = usize::MAX;

const INLINE: &[Form] = &[Form::Inline];
const POOLED: &[Form] = &[Form::Pooled];
const SEALED: &[Form] = &[Form::Inline, Form::Sealed];
const MIXED: &[Form] = &[Form::Inline, Form::Pooled, Form::Sealed];

/// The budget of a link whose ends may close or die.
fn ends(messages: u8) -> Budget {
    Budget {
        messages,
        closes: 1,
        deaths: 1,
        ..Budget::default()
    }
}

impl LinkScope {
    /// Whether the link is one of a service.
    #[must_use]
    pub fn is_service(&self) -> bool {
        self.kind == LinkKind::Service
    }

    /// All scopes.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let mut all = Self::topics();
        all.extend(Self::topics_that_fill());
        all.extend(Self::topics_that_end());
        all.extend(Self::services());
        all
    }

    /// A link of a topic with two slots and a socket that is never full.
    fn topic(
        name: &'static str,
        reliable: bool,
        depth: u16,
        forms: &'static [Form],
        messages: u8,
    ) -> Self {
        Self {
            name,
            kind: LinkKind::Topic,
            reliable,
            sealed: false,
            depth: [depth; 2],
            max_borrowed: [depth; 2],
            forms,
            segments: 1,
            slots: 2,
            socket: ROOMY,
            budget: Budget {
                messages,
                ..Budget::default()
            },
            start: Start::Connected,
            quick: true,
            fault: None,
        }
    }

    /// Links of topics that stay open.
    fn topics() -> Vec<Self> {
        vec![
            // Shows link, LNK-ORDER (model), bound: best effort, depth 1; 8 publications inline.
            Self::topic("link-keep-last-1", false, 1, INLINE, 8),
            // Shows link, LNK-ORDER (model), bound: best effort, depth 2; 8 publications inline.
            Self::topic("link-keep-last-2", false, 2, INLINE, 8),
            // Shows link, DAT-REFS, LNK-ORDER (model), bound: best effort, depth 2 to 1, 3 held; 4 publications, each
            // inline, pooled or sealed.
            Self {
                depth: [2, 1],
                max_borrowed: [1, 3],
                ..Self::topic("link-forms-4", false, 2, MIXED, 4)
            },
            // Shows link, LNK-ORDER, LNK-DEBT (model), bound: reliable, depth 1; 8 publications, 2 deadlines.
            Self {
                budget: Budget {
                    messages: 8,
                    skips: 2,
                    ..Budget::default()
                },
                ..Self::topic("link-reliable-1", true, 1, INLINE, 8)
            },
            // Shows link, LNK-ORDER (model), bound: reliable, depth 2; 9 publications.
            Self::topic("link-reliable-2", true, 2, INLINE, 9),
            // Shows link, LNK-ORDER, LNK-DEBT (model), bound: reliable, depth 1, 2 held; 6 publications, 2 deadlines.
            Self {
                max_borrowed: [1, 2],
                budget: Budget {
                    messages: 6,
                    skips: 2,
                    ..Budget::default()
                },
                ..Self::topic("link-debt", true, 1, INLINE, 6)
            },
        ]
    }

    /// Links of topics with few slots, or whose socket is full.
    fn topics_that_fill() -> Vec<Self> {
        vec![
            // Shows link, DAT-REFS, LNK-ORDER (model), bound: best effort, depth 1, a socket of 1 packet; 7 pooled
            // publications in 2 slots.
            Self {
                socket: 1,
                ..Self::topic("link-full", false, 1, POOLED, 7)
            },
            // Shows link, LNK-ORDER, LNK-ABSORB (model), bound: reliable, depth 1, a socket of 2 packets; 6
            // publications, a close, a death.
            Self {
                socket: 2,
                budget: ends(6),
                ..Self::topic("link-full-ends", true, 1, INLINE, 6)
            },
            // Shows link, DAT-REFS, LNK-ORDER (model), bound: best effort, depth 1, a socket of 1 packet; 5 pooled
            // publications, 2 segments of 1 slot, 2 retired.
            Self {
                slots: 1,
                segments: 2,
                socket: 1,
                max_borrowed: [2; 2],
                budget: Budget {
                    messages: 5,
                    retires: 2,
                    ..Budget::default()
                },
                ..Self::topic("link-retires", false, 1, POOLED, 5)
            },
            // Shows link, DAT-REFS, LNK-ORDER (model), bound: reliable, depth 2; 8 pooled publications in 3 slots.
            Self {
                slots: 3,
                ..Self::topic("link-pooled", true, 2, POOLED, 8)
            },
        ]
    }

    /// Links of topics whose ends close or die, and the searches that take longest.
    fn topics_that_end() -> Vec<Self> {
        vec![
            // Shows link, DAT-REFS, LNK-ORDER, LNK-ABSORB (model), bound: best effort, depth 1; 4 publications of all
            // forms, a close, a death.
            Self {
                budget: ends(4),
                ..Self::topic("link-ends", false, 1, MIXED, 4)
            },
            // Shows link, DAT-REFS, LNK-ORDER, LNK-ABSORB (model), bound: reliable, depth 2; 5 pooled publications in 4
            // slots, a close, a death.
            Self {
                slots: 4,
                budget: ends(5),
                ..Self::topic("link-reliable-ends", true, 2, POOLED, 5)
            },
            // Shows link, DAT-REFS, LNK-ORDER, LNK-ABSORB (model), bound: a sealed link, best effort, depth 1; 5
            // publications inline or sealed, a close, a death.
            Self {
                sealed: true,
                budget: ends(5),
                ..Self::topic("link-sealed-ends", false, 1, SEALED, 5)
            },
            // Shows link, DAT-REFS, LNK-ORDER (model, full), bound: as link-forms-4 with 5 publications.
            Self {
                depth: [2, 1],
                max_borrowed: [1, 3],
                quick: false,
                ..Self::topic("link-forms-5", false, 2, MIXED, 5)
            },
            // Shows link, DAT-REFS, LNK-ORDER, LNK-ABSORB (model, full), bound: as link-ends with 5 publications, 2
            // held.
            Self {
                max_borrowed: [2; 2],
                budget: ends(5),
                quick: false,
                ..Self::topic("link-ends-5", false, 1, MIXED, 5)
            },
        ]
    }

    fn services() -> Vec<Self> {
        let service = |name, forms, budget| Self {
            name,
            kind: LinkKind::Service,
            reliable: true,
            sealed: false,
            depth: [1; 2],
            max_borrowed: [1; 2],
            forms,
            segments: 1,
            slots: 2,
            socket: ROOMY,
            budget,
            start: Start::Opened,
            quick: true,
            fault: None,
        };
        let calls = |messages, cancels, closes, deaths| Budget {
            messages,
            cancels,
            closes,
            deaths,
            ..Budget::default()
        };
        vec![
            // Shows link, RPC-ONCE (model), bound: a service from the beginning; 2 calls, 2 cancels.
            Self {
                start: Start::Connected,
                ..service("link-calls-2", INLINE, calls(2, 2, 0, 0))
            },
            // Shows link, RPC-ONCE (model), bound: 3 calls, 1 cancel; window 2.
            service("link-calls-3", INLINE, calls(3, 1, 0, 0)),
            // Shows link, RPC-ONCE (model, full), bound: 5 calls; window 2.
            Self {
                quick: false,
                ..service("link-calls-5", INLINE, calls(5, 0, 0, 0))
            },
            // Shows link, DAT-REFS, RPC-ONCE (model), bound: 3 pooled calls and replies; window 3.
            Self {
                max_borrowed: [2; 2],
                ..service("link-calls-pooled", POOLED, calls(3, 0, 0, 0))
            },
            // Shows link, RPC-ONCE (model), bound: 3 calls, sockets of 1 packet.
            Self {
                socket: 1,
                ..service("link-calls-full", INLINE, calls(3, 0, 0, 0))
            },
            // Shows link, RPC-ONCE (model), bound: 2 calls, 1 cancel, sockets of 1 packet.
            Self {
                socket: 1,
                ..service("link-cancels-full", INLINE, calls(2, 1, 0, 0))
            },
            // Shows link, RPC-ONCE, LNK-ABSORB (model), bound: from the beginning; 2 calls, 1 cancel, a close, a death.
            Self {
                start: Start::Connected,
                ..service("link-calls-ends", INLINE, calls(2, 1, 1, 1))
            },
            // Shows link, DAT-REFS, RPC-ONCE, LNK-ABSORB (model), bound: 3 pooled calls, a close, a death.
            service("link-calls-ends-3", POOLED, calls(3, 0, 1, 1)),
            // Shows link, RPC-ONCE (model, full), bound: 4 calls, 1 cancel.
            Self {
                quick: false,
                ..service("link-calls-4", INLINE, calls(4, 1, 0, 0))
            },
        ]
    }

    /// The scope with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|it| it.name == name)
    }

    pub(super) fn config(&self, at: usize) -> Config {
        let roles = match self.is_service() {
            true => [Role::Caller, Role::Server],
            false => [Role::Sender, Role::Receiver],
        };
        Config {
            id: LinkId {
                epoch: 1,
                serial: 2,
            },
            version: 1,
            role: roles[at],
            reliable: self.reliable,
            sealed: self.sealed,
            ring: false,
            depth: self.depth[at],
            max_borrowed: self.max_borrowed[at],
            max_len: MaxLen::DEFAULT,
            deadline: Period::NONE,
            lifespan: Period::NONE,
            lease: Period::NONE,
            publications: Publications::UNKNOWN,
        }
    }
}
