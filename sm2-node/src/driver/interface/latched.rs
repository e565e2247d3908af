//! The last messages of a publisher, for subscribers that come later.

use std::collections::{HashSet, VecDeque};

use sm2_proto::Contract;
use sm2_proto::link::Fate;

use crate::driver::context::Context;
use crate::driver::link::LinkDriver;
use crate::driver::outbox::{MessageKey, Outbox};

/// The last messages of a publisher, which the outbox holds for links that open later.
#[derive(Debug)]
pub(super) struct LatchedMessages {
    /// At most `capacity`, the oldest first.
    keys: VecDeque<MessageKey>,
    /// 0 if the publisher latches nothing, and at all other interfaces.
    capacity: usize,
}

impl LatchedMessages {
    pub(super) fn of(contract: &Contract) -> Self {
        Self {
            keys: VecDeque::new(),
            capacity: match contract {
                Contract::Publisher { offer, .. } => usize::from(offer.latched),
                _ => 0,
            },
        }
    }

    /// Whether the publisher latches messages.
    #[inline]
    pub(super) const fn is_used(&self) -> bool {
        self.capacity > 0
    }

    pub(super) fn raw_keys(&self) -> HashSet<u64> {
        self.keys.iter().map(|key| key.to_raw()).collect()
    }

    /// Keeps a message, instead of the oldest one if there are too many.
    #[inline]
    pub(super) fn push(&mut self, key: MessageKey, outbox: &mut Outbox) {
        if !self.is_used() {
            return;
        }
        outbox.hold(key);
        self.keys.push_back(key);
        if self.keys.len() > self.capacity
            && let Some(oldest) = self.keys.pop_front()
        {
            outbox.release(oldest);
        }
    }

    /// Sends the latched messages on a link that has just opened, before all other messages. On a
    /// reliable link, sends as many at a time as the link has room for.
    //= SM2-QOS-005
    pub(super) fn replay(
        &self,
        link: &mut LinkDriver,
        context: &mut Context<'_>,
        outbox: &mut Outbox,
    ) {
        if !link.is_open() {
            return;
        }
        if !link.backlog.is_filled {
            link.backlog.is_filled = true;
            for &key in &self.keys {
                outbox.hold(key);
                link.backlog.keys.push_back(key);
            }
        }
        while let Some(&key) = link.backlog.keys.front() {
            let label = outbox.label(key);
            let len = label.map_or(0, |label| label.len);
            let is_expired = label.is_some_and(|label| link.is_expired(label.time));
            if is_expired || !link.accepts(len) {
                link.backlog.keys.pop_front();
                match is_expired {
                    true => link.drop_publication(Fate::Expired, context, outbox),
                    false => link.drop_too_long(len, context, outbox),
                }
                outbox.release(key);
                continue;
            }
            if link.is_reliable() && !link.has_room_for_backlog() {
                // On the ring lane, only DOORBELL tells of new room, so the link parks and then
                // looks once more.
                link.park();
                link.harvest(context, outbox);
                if !link.has_room_for_backlog() {
                    break;
                }
            }
            link.backlog.keys.pop_front();
            link.send_from_backlog(key, context, outbox);
            outbox.release(key);
            if link.backlog.keys.front() == Some(&key) {
                // The socket does not accept the ATTACH of its segment.
                break;
            }
        }
    }
}
