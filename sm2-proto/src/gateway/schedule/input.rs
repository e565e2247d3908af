//! The inputs and outputs of a schedule.

use super::{super::OfferId, SendQos};
use crate::Instant;

/// A message in the queue of its topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct QueuedMessage<M> {
    /// The driver's message. The scheduler only hands it back.
    pub message: M,
    /// Its length on the network, with its header.
    pub len_bytes: u64,
    /// The time of its publication.
    pub published_at: Instant,
}

/// An input of a [`Schedule`](super::Schedule).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input<M> {
    /// The peer wants a topic.
    Open {
        /// The offer of the topic.
        offer: OfferId,
        /// How its messages are sent.
        qos: SendQos,
    },
    /// The QoS of a topic has changed.
    Change {
        /// The offer of the topic.
        offer: OfferId,
        /// How its messages are sent from now on.
        qos: SendQos,
    },
    /// The peer no longer wants a topic, or may no longer have it.
    Close {
        /// The offer of the topic.
        offer: OfferId,
    },
    /// A message was published.
    Enqueue {
        /// The offer of its topic.
        offer: OfferId,
        /// The message.
        message: QueuedMessage<M>,
    },
    /// The memory that the messages may occupy has changed.
    Limit {
        /// The new limit.
        max_bytes: u64,
    },
    /// The first byte of the next message of a topic can be written. Legal for a [`Next::Start`] of the
    /// [order](super::Schedule::order). If the message is too old by now, it is dropped.
    Start {
        /// The offer of the topic.
        offer: OfferId,
    },
    /// Every byte of the message in flight has left at least once, or the peer has refused it.
    Sent {
        /// The offer of its topic.
        offer: OfferId,
    },
    /// Time has passed.
    Tick,
}

/// An output of a [`Schedule`](super::Schedule).
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output<M> {
    /// The message is in flight: send it in the [order](super::Schedule::order).
    Start {
        /// The offer of its topic.
        offer: OfferId,
        /// The message.
        message: M,
    },
    /// The message, which was not started, is not sent.
    Drop {
        /// The offer of its topic.
        offer: OfferId,
        /// The message.
        message: M,
        /// The reason.
        cause: DropCause,
    },
    /// Abandon the message in flight: reset its stream.
    Reset {
        /// The offer of its topic.
        offer: OfferId,
    },
}

/// One step of the [order](super::Schedule::order) of a driver that writes messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Next {
    /// Write bytes of the message in flight.
    Continue {
        /// The offer of its topic.
        offer: OfferId,
    },
    /// Start the next message with [`Input::Start`].
    Start {
        /// The offer of its topic.
        offer: OfferId,
    },
}

impl Next {
    /// The offer of the topic.
    #[must_use]
    pub const fn offer(self) -> OfferId {
        match self {
            Self::Continue { offer } | Self::Start { offer } => offer,
        }
    }
}

/// Why a message was dropped before it was started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DropCause {
    /// Newer messages took its place in the queue.
    Superseded,
    /// Newer messages, perhaps of other topics, took its place in the memory budget.
    Displaced,
    /// It exceeded [`SendQos::max_age`].
    Expired,
    /// Its topic was closed.
    Withdrawn,
}

/// An input that is not legal now; nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Misuse {
    /// The topic of this offer is open already.
    #[error("the topic of this offer is open already")]
    Open,
    /// The topic of this offer is not open.
    #[error("the topic of this offer is not open")]
    NotOpen,
    /// No message of this offer may start now.
    #[error("no message of this offer may start now")]
    NotReady,
    /// The topic of this offer has no message in flight.
    #[error("the topic of this offer has no message in flight")]
    NotSending,
}
