//! What a connection is told, and what it says.

use super::{CallId, Message, PeerCall};
use bytes::Bytes;
use sm2_proto::{
    Code, Instant, Name,
    gateway::{
        AskId, Hop, OfferId, Outcome, PeerFarewell, PeerViolationKind, Subject, SubjectKind,
        Verdict,
        schedule::SendQos,
        session::{self, End},
    },
};

/// What a connection is to do.
#[derive(Clone, Debug)]
pub enum Command {
    /// Offer this to the peer.
    Offer {
        /// The number of the offer.
        offer: OfferId,
        /// What it is.
        subject: Subject,
        /// From its origin to this gateway.
        path: Vec<Hop>,
        /// How its messages are sent, if it is a topic.
        qos: SendQos,
    },
    /// Do not offer it any more.
    Unoffer {
        /// Which.
        offer: OfferId,
    },
    /// There are other rules for an offer.
    Change {
        /// Which.
        offer: OfferId,
        /// How its messages are sent from now on.
        qos: SendQos,
    },
    /// Want what the peer offers.
    Want {
        /// Which.
        offer: OfferId,
        /// How many messages wait for this side at most.
        depth: u16,
    },
    /// Do not want it any more.
    Unwant {
        /// Which.
        offer: OfferId,
    },
    /// Ask whether this side could have that; the answer is [`session::Event::Answered`].
    Ask {
        /// The number of the question.
        ask: AskId,
        /// A topic or a service.
        kind: SubjectKind,
        /// Its name.
        name: Name,
    },
    /// Answer the oldest question.
    Answer {
        /// Its number.
        ask: AskId,
        /// What it is.
        verdict: Verdict,
    },
    /// Send this message, if the peer wants it.
    Message {
        /// The offer of its topic.
        offer: OfferId,
        /// The message.
        message: Message,
    },
    /// Call a service of the peer's.
    Call {
        /// The caller's name for it: in the [`Event::Reply`].
        call: CallId,
        /// Which service.
        offer: OfferId,
        /// When the caller gives up.
        deadline: Option<Instant>,
        /// The request.
        payload: Bytes,
    },
    /// Nobody waits for the reply any more.
    Forget {
        /// Of which call.
        call: CallId,
    },
    /// Reply to a call of the peer's.
    Reply {
        /// Which, by its [`Event::Request`].
        call: PeerCall,
        /// How it went.
        outcome: Outcome,
        /// The reply, or why it failed.
        payload: Bytes,
    },
    /// End the connection.
    Close(Code),
}

/// What happened on a connection.
#[derive(Clone, Debug)]
pub enum Event {
    /// An event of the control stream.
    Session(session::Event),
    /// A question could not be asked: too many questions wait for an answer, or the connection is
    /// not open.
    NotAsked {
        /// The number of the question.
        ask: AskId,
    },
    /// A message came, whole.
    Message {
        /// The offer of its topic.
        offer: OfferId,
        /// The message.
        message: Message,
    },
    /// The peer calls.
    Request {
        /// For the [`Command::Reply`].
        call: PeerCall,
        /// Which service.
        offer: OfferId,
        /// When the caller gives up.
        deadline: Option<Instant>,
        /// The request.
        payload: Bytes,
    },
    /// The peer does not want this reply any more.
    Cancelled {
        /// Which call.
        call: PeerCall,
    },
    /// A call of this side is over.
    Reply {
        /// Which.
        call: CallId,
        /// How it went.
        outcome: Outcome,
        /// The reply, or why it failed.
        payload: Bytes,
    },
    /// The connection is over; nothing comes after.
    Ended(Reason),
}

/// Why a connection is over.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Reason {
    /// Something was said on it.
    #[error("{}", said(.0))]
    Said(End),
    /// There never was one: the other side was not reached, or did not show that it is who it
    /// should be.
    #[error("no connection: {0}")]
    Handshake(String),
}

fn said(end: &End) -> String {
    match end {
        End::Violation(violation) => format!("closed: the peer broke the protocol: {violation}"),
        End::Local(code) => format!("closed: {}", name_of(*code)),
        End::Closed(Some(code)) => format!("closed by the peer: {}", name_of(*code)),
        End::Closed(None) => "lost: nothing came for 5 s, or the peer was restarted".to_owned(),
    }
}

fn name_of(code: Code) -> String {
    let farewell = PeerFarewell::from_code(code).map(PeerFarewell::name);
    let violation = || PeerViolationKind::from_code(code).map(PeerViolationKind::name);
    let name = farewell.or_else(violation);
    name.map_or_else(|| format!("code {}", code.0), str::to_owned)
}

/// How much of a peer this side keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The longest payload that is taken.
    pub message_bytes: u64,
    /// All payloads that are not whole yet.
    pub memory_bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            message_bytes: 64 << 20,
            memory_bytes: 128 << 20,
        }
    }
}

/// Who this side is, for its sessions.
#[derive(Clone, Debug)]
pub struct Me {
    /// Its id and epoch.
    pub hop: Hop,
    /// What people call it.
    pub name: Name,
}

/// What is not over on a connection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Held {
    /// Streams of the peer's for the control stream and calls.
    pub bidirectional: u64,
    /// Streams of the peer's for messages.
    pub unidirectional: u64,
    /// Payloads that are not whole.
    pub payloads: usize,
    /// Calls without a reply, both ways, and what is not written of them.
    pub calls: usize,
}
