//! Which links are suspended so that a publisher stays below the limit of its memory.
//!
//! A subscriber that keeps its samples keeps their memory too. When messages that links hold take
//! more than half of the memory that is left to them, the link with the oldest message in flight is
//! suspended, until the rest is within that half. A suspended link gets no message until its
//! subscriber releases one. The other half is for the links that release what they get.

use std::collections::HashMap;

use super::latched::LatchedMessages;
use super::links::Links;
use crate::driver::link::LinkDriver;
use crate::driver::outbox::{MessageKey, Outbox, Room};
use crate::driver::token::LinkToken;

/// The active links with messages in flight, the one with the oldest message first. Each message that one of them holds
/// counts in `alone` of exactly one.
pub(super) struct Holders(Vec<Holder>);

/// An active link with messages in flight.
struct Holder {
    /// The number of its oldest message.
    oldest: u64,
    token: LinkToken,
    /// The memory of its messages.
    bytes: u64,
    /// The memory of messages that no younger holder has.
    alone: u64,
}

impl Holders {
    /// Suspends the links that hold too much for a message of this length, the one with the oldest message first. Links
    /// that have released something since are active again.
    //= SM2-QOS-007
    pub(super) fn suspend(
        len: u64,
        links: &mut Links,
        outbox: &mut Outbox,
        latched: &LatchedMessages,
    ) {
        for link in links.iter_mut() {
            link.resume_if_released();
        }
        let Self(mut holders) = Self::among(links, outbox, latched);
        let held = holders.iter().map(|it| it.alone).sum();
        let mut room = outbox.room(len, held);
        let exceeds = |room: &Room| room.held.saturating_add(len) > room.bound();
        let mut count = 0;
        while exceeds(&room) && count < holders.len() {
            room = room.without(holders[count].alone);
            count += 1;
        }
        holders.truncate(count);
        // A link that holds a few old messages need not be suspended for the sake of them.
        for holder in holders {
            let with = room.with(holder.bytes);
            if !exceeds(&with) {
                room = with;
            } else if let Some(link) = links.get_mut(holder.token) {
                link.suspend();
            }
        }
        outbox.check_from(room);
    }

    fn among(links: &Links, outbox: &Outbox, latched: &LatchedMessages) -> Self {
        let latched = latched.raw_keys();
        // The number and the memory of a message. The publisher itself needs the memory of latched ones.
        let footprint = |key| match latched.contains(&key) {
            true => None,
            false => outbox.footprint(MessageKey::from_raw(key)),
        };
        let holder = |link: &LinkDriver| {
            let (mut oldest, mut bytes) = (u64::MAX, 0);
            link.in_flight_keys(|key| {
                if let Some((id, footprint)) = footprint(key) {
                    oldest = oldest.min(id);
                    bytes += footprint;
                }
            });
            (bytes > 0).then(|| Holder {
                token: link.token(),
                oldest,
                bytes,
                alone: 0,
            })
        };
        let active = (links.iter()).filter(|link| link.is_open() && !link.is_suspended());
        let mut holders: Vec<_> = active.filter_map(holder).collect();
        holders.sort_by_key(|it| it.oldest);
        let mut youngest = HashMap::new();
        for (rank, holder) in holders.iter().enumerate() {
            if let Some(link) = links.get(holder.token) {
                link.in_flight_keys(|key| {
                    youngest.insert(key, rank);
                });
            }
        }
        for (key, rank) in youngest {
            if let Some((_, bytes)) = footprint(key) {
                holders[rank].alone += bytes;
            }
        }
        Self(holders)
    }
}
