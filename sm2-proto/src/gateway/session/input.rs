//! The inputs and outputs of a session.

use alloc::{borrow::ToOwned, format, string::String, vec::Vec};

use super::super::{
    AskId, GatewayId, Header, Hop, OfferId, PeerViolation, StreamToken, Subject, SubjectKind,
    Verdict,
};
use crate::{
    Code, Name,
    limits::{OFFERS_MAX, QUESTIONS_MAX},
};

/// An input of a session. All outputs of the input before are drained first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input<'a> {
    /// An event of the connection.
    Event(PeerEvent<'a>),
    /// A command of this side. Legal when the HELLO of the peer has come.
    Command(Command),
    /// Closes the connection with this code.
    Close(Code),
    /// The deadline has come.
    Tick,
}

/// How a message, a request or a reply arrives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Transport {
    /// A stream of its own.
    Stream(StreamToken),
    /// A QUIC datagram. Only messages may come in datagrams.
    Datagram,
}

/// An event of the connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PeerEvent<'a> {
    /// Bytes of the control stream, in pieces of any length.
    Control(&'a [u8]),
    /// The header of a message, a request or a reply has arrived.
    Header {
        /// The stream or datagram of the header.
        transport: Transport,
        /// The header.
        header: Header,
    },
    /// The connection or the control stream has ended, with the code of the peer if it sent one.
    Closed(Option<Code>),
    /// The peer broke SPEC in bytes that the session does not see, such as the payload of a stream.
    Violation(PeerViolation),
}

/// A command of this side.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// Offers a subject to the peer.
    Offer {
        /// The number of the new offer, greater than all before.
        offer: OfferId,
        /// The topic or service.
        subject: Subject,
        /// The gateways from the origin to this one.
        path: Vec<Hop>,
    },
    /// A command that is about the control stream alone.
    Control(ControlCommand),
    /// Registers a call before its request is written.
    Call {
        /// The stream of the call.
        stream: StreamToken,
        /// The offer of the service.
        offer: OfferId,
    },
    /// Forgets a call. The driver resets its stream and feeds nothing of it from now on.
    Forget {
        /// The stream of the call.
        stream: StreamToken,
    },
}

/// A command that is about the control stream alone. An owner that holds more than the session does,
/// such as streams, passes it on unchanged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ControlCommand {
    /// Withdraws an offer.
    Unoffer {
        /// The number of the offer.
        offer: OfferId,
    },
    /// Wants an offer of the peer. If the peer has not confirmed an earlier UNWANT, the session sends
    /// WANT when it does.
    Want {
        /// The number of the offer.
        offer: OfferId,
        /// The most messages that wait for this side, 1 to 1,024.
        depth: u16,
    },
    /// No longer wants an offer of the peer. Calls of the offer fail.
    Unwant {
        /// The number of the offer.
        offer: OfferId,
    },
    /// Asks the peer whether this side could have a topic or service.
    Ask {
        /// The number of the question, chosen freely.
        ask: AskId,
        /// Whether the name is of a topic or a service.
        kind: SubjectKind,
        /// The name.
        name: Name,
    },
    /// Answers the oldest question of the peer.
    Answer {
        /// The number of the question.
        ask: AskId,
        /// The answer.
        verdict: Verdict,
    },
}

/// Work for the driver of a session, and events for its owner.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Write these bytes to the control stream, after all earlier ones.
    Transmit(Vec<u8>),
    /// Accept the payload behind the header that was fed last.
    Take {
        /// The stream or datagram of the header.
        transport: Transport,
    },
    /// Discard a message that this side no longer wants; stop its stream.
    Discard {
        /// The stream or datagram of the message.
        transport: Transport,
    },
    /// Reply to a call of the peer with *unreachable*.
    Unreachable {
        /// The stream of the call.
        stream: StreamToken,
    },
    /// A call of this side has failed as *unreachable*. Reset its stream and feed nothing more of it.
    CallFailed {
        /// The stream of the call.
        stream: StreamToken,
    },
    /// An event for the owner of the session.
    Event(Event),
    /// The session has ended: close the connection with the code of this reason. It is the last output.
    Ended(End),
}

/// An event for the owner of a session. Drivers pass it on unchanged.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Event {
    /// The HELLO of the peer has come.
    Greeted {
        /// The id of the peer.
        peer: GatewayId,
        /// The epoch of its process.
        epoch: u64,
        /// Its name, for people.
        name: Name,
    },
    /// The peer offers a subject.
    Offered {
        /// The number of the offer.
        offer: OfferId,
        /// The topic or service.
        subject: Subject,
        /// The gateways from the origin to the peer.
        path: Vec<Hop>,
    },
    /// The peer has withdrawn an offer.
    Gone {
        /// The number of the offer.
        offer: OfferId,
    },
    /// The peer wants an offer of this side.
    Wanted {
        /// The number of the offer.
        offer: OfferId,
        /// The most messages that wait for the peer.
        depth: u16,
    },
    /// The peer no longer wants an offer of this side.
    Unwanted {
        /// The number of the offer.
        offer: OfferId,
    },
    /// The peer asks whether it could have a topic or service. Answer questions in their order.
    Asked {
        /// The number of the question.
        ask: AskId,
        /// Whether the name is of a topic or a service.
        kind: SubjectKind,
        /// The name.
        name: Name,
    },
    /// The peer has answered the oldest question of this side.
    Answered {
        /// The number of the question.
        ask: AskId,
        /// The answer.
        verdict: Verdict,
    },
}

/// Why a session has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum End {
    /// The peer broke SPEC.
    #[error("the peer broke the protocol: {0}")]
    Violation(PeerViolation),
    /// This side closed the connection.
    #[error("closed by this gateway ({0})")]
    Local(Code),
    /// The peer closed the connection with this code, or the connection was lost.
    #[error("{}", closed(*.0))]
    Closed(Option<Code>),
}

fn closed(code: Option<Code>) -> String {
    code.map_or_else(
        || "the connection was lost".to_owned(),
        |code| format!("closed by the peer ({code})"),
    )
}

/// The reason why an input was not taken.
pub type Error = crate::Error<End, Misuse>;

/// A misuse by the driver. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Misuse {
    /// The HELLO of the peer has not come yet.
    #[error("the peer has not sent its HELLO yet")]
    NotOpen,
    /// The number of the offer is not greater than all before.
    #[error("the number of an offer must be greater than all before")]
    OfferNumber,
    /// 4,096 offers are not gone.
    #[error("a connection has at most {OFFERS_MAX} offers of each side")]
    TooManyOffers,
    /// The path does not end with this gateway, names the peer, or is not legal.
    #[error(
        "the path of an offer must end with this gateway, and name 1 to 8 gateways once, the peer not among them"
    )]
    WrongPath,
    /// The offer does not exist, or its state does not allow the command.
    #[error("the offer does not exist, or its state does not allow this")]
    WrongOffer,
    /// `depth` is out of range.
    #[error("`depth` must be 1 to 1,024")]
    WrongDepth,
    /// 64 questions have no answer yet.
    #[error("at most {QUESTIONS_MAX} questions may wait for an answer")]
    TooManyQuestions,
    /// The oldest question of the peer has another number.
    #[error("questions must be answered in their order")]
    NotAsked,
    /// The stream has a call already.
    #[error("the stream has a call already")]
    StreamInUse,
    /// The stream has no call without a reply.
    #[error("the stream has no call without a reply")]
    NoCall,
}
