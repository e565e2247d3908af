//! The events of a connection.

use bytes::Bytes;
use quinn_proto::ConnectionError;
use sm2_proto::{
    Code, Instant,
    gateway::{
        AskId, OfferId, Outcome, PeerFarewell, PeerViolationKind,
        session::{self, End},
    },
};

use super::id::{CallId, PeerCall};
use crate::message::Message;

/// An event of a connection.
#[derive(Clone, Debug)]
pub enum Event {
    /// An event of the session with the peer.
    Session(session::Event),
    /// A question could not be asked: too many questions wait for an answer, or the connection is
    /// not open.
    NotAsked {
        /// The number of the question.
        ask: AskId,
    },
    /// A message has arrived completely.
    Message {
        /// The offer of its topic.
        offer: OfferId,
        /// The message.
        message: Message,
    },
    /// The peer calls a service.
    Request {
        /// The call, which the [`Command::Reply`](super::Command::Reply) repeats.
        call: PeerCall,
        /// The offer of the service.
        offer: OfferId,
        /// The time when the caller gives up.
        deadline: Option<Instant>,
        /// The request.
        payload: Bytes,
    },
    /// The peer no longer wants the reply to a call. This can also concern a call whose request has
    /// not arrived completely, so that no [`Event::Request`] came for it.
    Cancelled {
        /// The call.
        call: PeerCall,
    },
    /// A call of this side is over.
    Reply {
        /// The hub's number of the call.
        call: CallId,
        /// The outcome of the call.
        outcome: Outcome,
        /// The reply, or the reason if the server says that the call failed; empty for every other
        /// outcome.
        payload: Bytes,
    },
    /// The connection has ended, and all calls of this side are over. Only commands that are given
    /// after this have events: [`Event::NotAsked`], and [`Event::Reply`] as *unreachable*.
    Ended(Reason),
}

impl Event {
    /// The reply to a call that cannot be made or completed.
    pub(super) fn unreachable(call: CallId) -> Self {
        Self::Reply {
            call,
            outcome: Outcome::Unreachable,
            payload: Bytes::new(),
        }
    }
}

/// Why a connection has ended.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Reason {
    /// The session has ended.
    #[error("{}", end_text(.0))]
    Session(End),
    /// The handshake failed: the peer was not reached, or its key is not the expected one.
    #[error("no connection: {0}")]
    Handshake(HandshakeError),
}

/// Why a handshake failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HandshakeError {
    /// QUIC gave up the connection.
    #[error(transparent)]
    Quic(#[from] ConnectionError),
    /// The peer showed no key. TLS refuses such a peer before.
    #[error("the peer showed no key")]
    NoKey,
}

impl Reason {
    /// True if the peer has a connection with another process of this gateway, of a greater epoch.
    #[must_use]
    pub fn is_stale(&self) -> bool {
        let stale = End::Closed(Some(PeerFarewell::Stale.code()));
        *self == Self::Session(stale)
    }
}

fn end_text(end: &End) -> String {
    match end {
        End::Violation(violation) => format!("closed: the peer broke the protocol: {violation}"),
        End::Local(code) => format!("closed: {}", code_name(*code)),
        End::Closed(Some(code)) => format!("closed by the peer: {}", code_name(*code)),
        End::Closed(None) => "lost: nothing came for 5 s, or the peer was restarted".to_owned(),
    }
}

fn code_name(code: Code) -> String {
    let farewell = PeerFarewell::from_code(code).map(PeerFarewell::name);
    let violation = || PeerViolationKind::from_code(code).map(PeerViolationKind::name);
    let name = farewell.or_else(violation);
    name.map_or_else(|| format!("code {}", code.0), str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A gateway that is stale does not dial the peer again before a while.
    #[test]
    fn only_one_farewell_says_that_this_process_is_stale() {
        let closed = |farewell: PeerFarewell| Reason::Session(End::Closed(Some(farewell.code())));
        assert!(closed(PeerFarewell::Stale).is_stale());
        assert!(!closed(PeerFarewell::Duplicate).is_stale());
        assert!(!Reason::Session(End::Closed(None)).is_stale());
        assert!(!Reason::Handshake(HandshakeError::NoKey).is_stale());
    }
}
