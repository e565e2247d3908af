//! Which links are suspended so that a publisher stays below the limit of its memory.
//!
//! A subscriber that keeps its samples keeps their memory too. When messages that links hold take
//! more than half of the memory that is left to them, the link with the oldest message in flight is
//! suspended, until the rest is within that half. A suspended link gets no message until its
//! subscriber releases one. The other half is for the links that release what they get.

use std::collections::{HashMap, HashSet};

use sm2_proto::Instant;
use sm2_proto::link::Fate;

use super::DeclaredInterface;
use crate::driver::context::Context;
use crate::driver::link::LinkDriver;
use crate::driver::outbox::{MessageKey, Room};
use crate::driver::token::LinkToken;
use crate::published::Published;

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

impl DeclaredInterface {
    /// Frees memory for a message of this length: settles what came back, and suspends links if
    /// that is due.
    pub(crate) fn prepare_memory(&mut self, len: u64, context: &mut Context<'_>) {
        if self.outbox.is_check_due(len) {
            self.harvest(context);
            if self.outbox.is_check_due(len) {
                self.suspend_holders(len);
            }
        }
    }

    /// Suspends the links that hold too much, the one with the oldest message first. Links that
    /// have released something since are active again.
    //= SM2-QOS-007
    pub(super) fn suspend_holders(&mut self, len: u64) {
        for link in self.links.iter_mut() {
            link.resume_if_released();
        }
        let mut holders = self.holders();
        let held = holders.iter().map(|it| it.alone).sum();
        let mut room = self.outbox.room(len, held);
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
            } else if let Some(link) = self.links.get_mut(holder.token) {
                link.suspend();
            }
        }
        self.outbox.check_from(room);
    }

    /// The active links with messages in flight, the one with the oldest message first.
    fn holders(&self) -> Vec<Holder> {
        let latched = self.latched.raw_keys();
        let mut holders: Vec<Holder> = (self.links())
            .filter(|link| link.is_open() && !link.is_suspended())
            .filter_map(|link| self.holder(link, &latched))
            .collect();
        holders.sort_by_key(|it| it.oldest);
        let mut youngest = HashMap::new();
        for (rank, holder) in holders.iter().enumerate() {
            if let Some(link) = self.links.get(holder.token) {
                link.in_flight_keys(|key| {
                    youngest.insert(key, rank);
                });
            }
        }
        for (key, rank) in youngest {
            let key = MessageKey::from_raw(key);
            if let Some((_, bytes)) = self.footprint_of(key, &latched) {
                holders[rank].alone += bytes;
            }
        }
        holders
    }

    fn holder(&self, link: &LinkDriver, latched: &HashSet<u64>) -> Option<Holder> {
        let (mut oldest, mut bytes) = (u64::MAX, 0);
        link.in_flight_keys(|key| {
            if let Some((id, footprint)) = self.footprint_of(MessageKey::from_raw(key), latched) {
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
    }

    /// The number and the memory of a message, unless it is latched: then the publisher itself needs
    /// the memory.
    fn footprint_of(&self, key: MessageKey, latched: &HashSet<u64>) -> Option<(u64, u64)> {
        match latched.contains(&key.to_raw()) {
            true => None,
            false => self.outbox.footprint(key),
        }
    }

    /// Counts a message that finds no memory, on every open link that accepts its length. `None` if no link
    /// holds a message:
    /// then the publisher itself uses the memory.
    //= SM2-QOS-007
    pub(crate) fn miss(
        &mut self,
        time: Instant,
        len: u64,
        context: &mut Context<'_>,
    ) -> Option<Published> {
        if !self.is_held() {
            return None;
        }
        self.published += 1;
        self.count_publication(time, len, self.links.count_open() > 0, context);
        let mut published = Published::default();
        for link in self.links.iter_mut().filter(|link| link.is_open()) {
            if link.accepts(len) {
                link.drop_publication(Fate::PoolLimit, context, &mut self.outbox);
            } else {
                link.drop_too_long(len, context, &mut self.outbox);
                published.too_long += 1;
            }
            published.missed += usize::from(link.is_reliable());
        }
        self.reports.report_drops(&mut self.links);
        Some(published)
    }

    /// Whether a link has messages in flight.
    pub(crate) fn is_held(&self) -> bool {
        self.links().any(|link| link.counters().in_flight > 0)
    }
}
