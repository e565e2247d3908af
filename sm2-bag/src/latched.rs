//! The latched state of recorded publishers.
//!
//! A subscriber that comes late gets the last messages of a latched publisher. A reader that begins in the middle of a
//! recording has to get them as well. So each file of a recording, and each copy that begins at a time, starts with the
//! latched state as of then. These messages are [repeated](crate::repeated): each is in a channel of its own, which
//! differs from that of its publisher only by its metadata. They are not a part of the counts, and readers of several
//! files leave out those that they have read before.

mod before;
mod kept;
mod once;
mod whole;

use mcap::Channel;
use sm2_proto::{Name, TypeId};

pub(crate) use self::kept::Kept;
pub(crate) use self::whole::Whole;
pub use self::whole::messages;
use crate::bag::Bag;
use crate::foreign;
use crate::source::Source;

/// The identity of a recorded publisher in all bags of a recording.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
struct Key {
    topic: Name,
    publisher: Name,
    data: TypeId,
}

/// The channels of a bag whose publishers are latched, each with its publisher and the number of latched messages.
fn channels(bag: &Bag) -> impl Iterator<Item = (&Channel<'static>, Key, usize)> {
    bag.channels().filter_map(|channel| {
        let source = Source::of_channel(channel);
        let source = source.or_else(|| foreign::source(channel).ok())?;
        let latched = usize::from(source.offer.latched);
        let key = Key {
            topic: source.topic,
            publisher: source.publisher,
            data: source.data,
        };
        (latched > 0).then_some((&**channel, key, latched))
    })
}
