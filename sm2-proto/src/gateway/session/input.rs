//! What goes into a session and comes out of it.

use alloc::{borrow::ToOwned, format, string::String, vec::Vec};

use super::super::{
    AskId, GatewayId, Header, Hop, OfferId, PeerViolation, StreamToken, Subject, SubjectKind,
    Verdict,
};
use crate::{Code, Name};

/// An input of a session. All outputs of the input before are drained first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input<'a> {
    /// Something happened on the connection.
    Event(PeerEvent<'a>),
    /// Our side asks for something. Legal once the peer has greeted.
    Command(Command),
    /// End the connection.
    Close(Code),
    /// Time has passed.
    Tick,
}

/// What carries a message, a request or a reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Carrier {
    /// A stream of its own.
    Stream(StreamToken),
    /// A QUIC datagram: a message alone can come this way.
    Datagram,
}

/// Something that happened on the connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PeerEvent<'a> {
    /// Bytes of the control stream, in any pieces.
    Control(&'a [u8]),
    /// The header of a message, a request or a reply has arrived.
    Header {
        /// What carries it.
        carrier: Carrier,
        /// What it says.
        header: Header,
    },
    /// The connection is over, or the control stream has ended; with the peer's code, if it sent one.
    Closed(Option<Code>),
    /// The peer broke SPEC in bytes that the session does not see, such as the payload of a stream.
    Violation(PeerViolation),
}

/// What our side asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// The peer may have this.
    Offer {
        /// Greater than all before.
        offer: OfferId,
        /// What it is.
        subject: Subject,
        /// From the origin to this gateway.
        path: Vec<Hop>,
    },
    /// It may not any more.
    Unoffer {
        /// Which.
        offer: OfferId,
    },
    /// What the peer offers is wanted; if that it was not has not been confirmed yet, once it is.
    Want {
        /// Which.
        offer: OfferId,
        /// How many messages wait at most, 1 to 1,024.
        depth: u16,
    },
    /// It is not wanted any more.
    Unwant {
        /// Which.
        offer: OfferId,
    },
    /// Could this side have that?
    Ask {
        /// The number of the question.
        ask: AskId,
        /// A topic or a service.
        kind: SubjectKind,
        /// Its name.
        name: Name,
    },
    /// The answer to the oldest question.
    Answer {
        /// Its number.
        ask: AskId,
        /// What it is.
        verdict: Verdict,
    },
    /// A stream for a call is about to be opened.
    Call {
        /// The driver's name for the stream.
        stream: StreamToken,
        /// The service.
        offer: OfferId,
    },
    /// Nobody waits for this call's reply any more: its stream is reset, and nothing of it comes
    /// here from now on.
    Forget {
        /// The stream.
        stream: StreamToken,
    },
}

/// What the driver does next.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Write these bytes to the control stream.
    Transmit(Vec<u8>),
    /// Read the payload behind this header.
    Take {
        /// What carries it.
        carrier: Carrier,
    },
    /// Discard the payload of a message that our side does not want any more; stop its stream.
    Discard {
        /// What carries it.
        carrier: Carrier,
    },
    /// Reply to the call of this stream that the server cannot be reached.
    Unreachable {
        /// Which.
        stream: StreamToken,
    },
    /// No reply to the call of this stream counts any more: reset it, and feed nothing of it.
    CallFailed {
        /// Which.
        stream: StreamToken,
    },
    /// News for the session's owner.
    Event(Event),
    /// The connection is over: close it with the code of this. Nothing comes after.
    Ended(End),
}

/// News for the owner of a session. Drivers pass it up unchanged.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Event {
    /// The peer has greeted.
    Greeted {
        /// Its id.
        peer: GatewayId,
        /// Of its process.
        epoch: u64,
        /// What people call it.
        name: Name,
    },
    /// The peer offers this.
    Offered {
        /// The number of the offer.
        offer: OfferId,
        /// What it is.
        subject: Subject,
        /// From the origin to the peer.
        path: Vec<Hop>,
    },
    /// The peer does not offer it any more.
    Gone {
        /// Which.
        offer: OfferId,
    },
    /// The peer wants what this side offers.
    Wanted {
        /// Which.
        offer: OfferId,
        /// How many messages wait for it at most.
        depth: u16,
    },
    /// The peer does not want it any more.
    Unwanted {
        /// Which.
        offer: OfferId,
    },
    /// The peer wants to know whether it could have that: answer in turn.
    Asked {
        /// The number of the question.
        ask: AskId,
        /// A topic or a service.
        kind: SubjectKind,
        /// Its name.
        name: Name,
    },
    /// The peer has answered.
    Answered {
        /// The number of the question.
        ask: AskId,
        /// What it said.
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

/// What a driver may not do; nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Misuse {
    /// The peer has not greeted yet.
    #[error("the peer has not greeted yet")]
    NotOpen,
    /// The number of an offer is not greater than all before.
    #[error("the number of an offer is greater than all before")]
    OfferNumber,
    /// There are as many offers as there may be.
    #[error("there are as many offers as there may be")]
    TooManyOffers,
    /// The path does not end here, leads back to the peer, or is no path.
    #[error(
        "the path of an offer ends with this gateway, does not come from the peer, and names 1 to 8 gateways once"
    )]
    WrongPath,
    /// No such offer, or not in this state.
    #[error("there is no such offer, or it is not in a state for this")]
    WrongOffer,
    /// `depth` is out of its range.
    #[error("`depth` is 1 to 1,024")]
    WrongDepth,
    /// As many questions wait for an answer as may.
    #[error("as many questions wait for an answer as may")]
    TooManyQuestions,
    /// The oldest question has another number.
    #[error("questions are answered in their order")]
    NotAsked,
    /// The stream has a call.
    #[error("the stream has a call already")]
    StreamInUse,
    /// The stream has no call without a reply.
    #[error("the stream has no call without a reply")]
    NoCall,
}
