use std::sync::Arc;

use sm2_proto::control::LinkPeer;
use sm2_proto::link::End;

/// An event of a publisher, subscriber, server or client.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Event {
    /// A link has opened: messages go to or come from this interface.
    Joined {
        /// The interface at the other end of the link.
        peer: Arc<LinkPeer>,
    },
    /// A link has ended. Messages that were received before can still be taken.
    Left {
        /// The interface at the other end of the link.
        peer: Arc<LinkPeer>,
        /// Why the link ended.
        end: End,
    },
    /// Messages were lost. At a subscriber: messages of this publisher that the program does not get, noticed when it
    /// takes the next one. At a publisher: messages that this subscriber does not get, because it was too slow, had no
    /// room, does not accept their length, or is gone.
    Lost {
        /// The interface at the other end of the link.
        peer: Arc<LinkPeer>,
        /// The number of messages.
        messages: u64,
    },
    /// Periods of a deadline have passed without a message (SM2-QOS-009). As long as messages are missing, this event
    /// comes at the end of each period.
    DeadlineMissed {
        /// At a subscriber, the publisher whose messages are missing. `None` at a publisher: it has published nothing.
        peer: Option<Arc<LinkPeer>>,
        /// The number of periods since the last event.
        periods: u64,
    },
    /// A publisher is not alive any more: neither a message nor an assertion has come within the lease (SM2-QOS-011).
    LivelinessLost {
        /// At a subscriber, the publisher. `None` at a publisher: its own program has shown no sign of life.
        peer: Option<Arc<LinkPeer>>,
    },
    /// A publisher that was not alive is alive again.
    LivelinessRegained {
        /// As in [`LivelinessLost`](Self::LivelinessLost).
        peer: Option<Arc<LinkPeer>>,
    },
}
