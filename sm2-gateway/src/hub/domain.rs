//! Events of the domain, and commands to the gateway's nodes there.

use bytes::Bytes;
use sm2_proto::{
    Instant, Name,
    gateway::{GatewayId, Outcome, Subject},
};

use super::shares::Links;
use crate::peer::CallId;

/// The number that the domain's side gives to a request for a remote server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RequestId(pub u64);

/// An event of the domain.
#[derive(Clone, Debug)]
pub enum LocalEvent {
    /// The domain has, or no longer has, publishers or servers of its own of a topic or service.
    Present {
        /// The topic or service.
        subject: Subject,
        /// True if the domain has some.
        present: bool,
    },
    /// The processes with publishers of a topic, or servers of a service, have changed. Comes before [`Present`], and
    /// again without any when the subject is gone.
    ///
    /// [`Present`]: Self::Present
    Links {
        /// The topic or service.
        subject: Subject,
        /// How many publishers or servers each process has.
        links: Links,
    },
    /// The number of interfaces that the Manager lets the gateway's node have for topics and services of the domain.
    Interfaces {
        /// The number.
        most: u64,
    },
    /// The subscribers of a remote topic in the domain have changed.
    Taken {
        /// The topic.
        subject: Subject,
        /// The gateway of the domain where it is published.
        origin: GatewayId,
        /// The greatest depth of the subscribers; `None` if there are none.
        taken: Option<u16>,
    },
    /// A publisher of the domain has published a message.
    Message {
        /// The topic.
        subject: Subject,
        /// The time of publication.
        published_at: Instant,
        /// The bytes of the message.
        payload: Bytes,
    },
    /// A publisher of the domain has published a message that is longer than
    /// [`Limits::message_bytes`](crate::peer::Limits::message_bytes).
    Refused {
        /// The topic.
        subject: Subject,
    },
    /// A remote message could not be published.
    Unpublished {
        /// The topic.
        subject: Subject,
        /// The gateway of the domain where it was published.
        origin: GatewayId,
    },
    /// A client of the domain calls a remote server.
    Request {
        /// The number of the request, which the [`LocalCommand::Reply`] repeats.
        request: RequestId,
        /// The service.
        subject: Subject,
        /// The gateway of the domain where the server is.
        origin: GatewayId,
        /// The time when the caller gives up.
        deadline: Option<Instant>,
        /// The request.
        payload: Bytes,
    },
    /// The caller no longer wants the reply to a request.
    Dropped {
        /// The number of the request.
        request: RequestId,
    },
    /// A server of the domain has replied.
    Replied {
        /// The number of the [`LocalCommand::Call`].
        call: CallId,
        /// The outcome of the call.
        outcome: Outcome,
        /// The reply, or the reason of the failure.
        payload: Bytes,
    },
}

/// A command to the gateway's nodes in the domain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LocalCommand {
    /// Subscribes to a topic, or becomes a client of a service.
    Subscribe {
        /// The topic or service.
        subject: Subject,
    },
    /// Ends a subscription, or a client.
    Unsubscribe {
        /// The topic or service.
        subject: Subject,
    },
    /// Declares a publisher or server that stands for remote ones.
    DeclareProxy {
        /// The topic or service.
        subject: Subject,
        /// The gateway of the domain where the remote ones are.
        origin: GatewayId,
        /// The name of the peer that offers them.
        peer: Name,
    },
    /// Withdraws a publisher or server that stands for remote ones.
    WithdrawProxy {
        /// The topic or service.
        subject: Subject,
        /// The gateway of the domain where the remote ones are.
        origin: GatewayId,
    },
    /// Publishes a remote message.
    Publish {
        /// The topic.
        subject: Subject,
        /// The gateway of the domain where it was published.
        origin: GatewayId,
        /// The bytes of the message.
        payload: Bytes,
    },
    /// Calls a server of the domain.
    Call {
        /// The number of the call, which the [`LocalEvent::Replied`] repeats.
        call: CallId,
        /// The service.
        subject: Subject,
        /// The time when the caller gives up.
        deadline: Option<Instant>,
        /// The request.
        payload: Bytes,
    },
    /// Cancels a call: its caller no longer waits.
    Cancel {
        /// The number of the call.
        call: CallId,
    },
    /// Replies to a request.
    Reply {
        /// The number of the request.
        request: RequestId,
        /// The outcome of the call.
        outcome: Outcome,
        /// The reply, or the reason of the failure.
        payload: Bytes,
    },
}
