//! The commands that the hub gives to a connection.

use std::sync::Arc;

use bytes::Bytes;
use sm2_proto::{
    Code, Instant,
    gateway::{Hop, OfferId, Outcome, Rules, Subject, schedule::SendQos, session::ControlCommand},
};

use super::id::{CallId, PeerCall};
use crate::message::Message;

/// A command to a connection.
///
/// A command that the peer's last frames have made pointless does nothing, such as a message of a
/// topic that the peer no longer wants. A call that cannot be made is answered with
/// [`Outcome::Unreachable`].
#[derive(Clone, Debug)]
pub enum Command {
    /// Offers a topic or service to the peer.
    Offer {
        /// The number of the offer.
        offer: OfferId,
        /// The topic or service.
        subject: Subject,
        /// The path from its origin to this gateway.
        path: Vec<Hop>,
        /// How the messages of a topic are sent.
        qos: SendQos,
    },
    /// Passes a command on to the session. An ASK is answered with
    /// [`session::Event::Answered`](sm2_proto::gateway::session::Event::Answered).
    Control(ControlCommand),
    /// Changes how the messages of an offered topic are sent.
    Change {
        /// The number of the offer.
        offer: OfferId,
        /// How messages are sent from now on.
        qos: SendQos,
    },
    /// Sends a message, if the peer wants its topic.
    Message {
        /// The offer of its topic.
        offer: OfferId,
        /// The message.
        message: Message,
    },
    /// Calls a service of the peer.
    Call {
        /// The hub's number of the call, which the
        /// [`Event::Reply`](super::Event::Reply) repeats.
        call: CallId,
        /// The offer of the service.
        offer: OfferId,
        /// The time when the caller gives up.
        deadline: Option<Instant>,
        /// The request.
        payload: Bytes,
    },
    /// Abandons a call: its caller no longer waits.
    Forget {
        /// The hub's number of the call.
        call: CallId,
    },
    /// Replies to a call of the peer.
    Reply {
        /// The call of the [`Event::Request`](super::Event::Request).
        call: PeerCall,
        /// The outcome of the call.
        outcome: Outcome,
        /// The reply, or the reason of the failure.
        payload: Bytes,
    },
    /// Other rules are in force. Until `None` follows, there may be offers that they deny: the connection sends
    /// nothing of those. `None` states that they are withdrawn.
    Rules(Option<Arc<Rules>>),
    /// Closes the connection with this code.
    Close(Code),
}
