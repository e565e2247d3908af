use std::sync::Arc;

use sm2_proto::control::LinkPeer;
use sm2_proto::link::End;

/// An event of a publisher, subscriber, server or client.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let map = domain.node("map")?.subscriber::<[f32]>("scan")?;
/// # let node = domain.node("lidar")?;
/// use sm2_node::Event;
///
/// let scans = node.publisher::<[f32]>("scan")?;
/// # scans.wait_for_subscribers(1)?;
/// match scans.events().next()? {
///     Event::Joined { peer } => println!("{} subscribes to {}", peer.name, scans.topic()),
///     Event::Left { peer, end } => println!("{} is gone: {end}", peer.name),
///     Event::Lost { peer, messages } => println!("{} misses {messages} messages", peer.name),
///     event => println!("{event:?}"),
/// }
/// # Ok(())
/// # }
/// ```
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
