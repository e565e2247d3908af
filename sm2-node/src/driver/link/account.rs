//! The account of a subscriber's link: how many messages were published while its publisher had no link.

use std::mem;

use sm2_io::CounterEntry;
use sm2_proto::link::{Account, Delivery};

use crate::driver::counters::update;
use crate::driver::interface::Header;

/// The account of a link, and what the driver needs for it. All of it is unused at the ends of publishers and services.
#[derive(Debug, Default)]
pub(super) struct LinkAccount {
    /// `None` until it is opened, and if the publisher does not say how many messages it has published.
    pub(super) account: Option<Account>,
    /// Whether messages have to be taken from an older link of the publisher first.
    pub(super) waits_for_older: bool,
    /// Whether the account has something to say about the next message. At most one branch for each message.
    pub(super) unsettled: bool,
    /// While it is unsettled: the messages before messages that have expired that were lost on the link, and those that
    /// were published while the publisher had no link.
    pub(super) with_expired: (u64, u64),
    /// The id of the last message that was taken or has expired; 0 if there is none.
    pub(super) last_id: u64,
    /// How many messages were published while the publisher had no link.
    away: u64,
}

/// The messages before a message, apart from those that were lost on the link.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Before {
    /// They were published while the publisher had no link.
    pub(super) away: u64,
    /// They were counted when the link opened, and this message reports them.
    pub(super) unreported: u64,
}

impl LinkAccount {
    /// How many messages were published while the publisher had no link.
    pub(super) const fn away(&self) -> u64 {
        self.away
    }

    /// Counts a message for the application. Until here, `lost` of its header is what the link lost before it, `own` of
    /// it since the last message that has expired. From here on, it is what the subscriber misses: messages that were
    /// published while there was no link belong to it, and messages that came by an older link do not.
    #[inline]
    pub(super) fn take(
        &mut self,
        header: &mut Header,
        own: u64,
        entry: Option<&mut CounterEntry>,
    ) -> Before {
        self.last_id = header.id;
        match self.unsettled {
            true => self.take_unsettled(header, own, entry),
            false => Before::default(),
        }
    }

    #[cold]
    fn take_unsettled(
        &mut self,
        header: &mut Header,
        own: u64,
        entry: Option<&mut CounterEntry>,
    ) -> Before {
        let Some(account) = &mut self.account else {
            return Before::default();
        };
        let missed = account.take(header.id, own);
        self.unsettled = !account.is_settled();
        self.add_away(missed.away, entry);
        let (lost, away) = mem::take(&mut self.with_expired);
        let away = away.saturating_add(missed.away);
        header.lost = lost.saturating_add(missed.lost).saturating_add(away);
        Before {
            away,
            unreported: missed.unreported,
        }
    }

    /// Counts messages that were published while the publisher had no link.
    pub(super) fn add_away(&mut self, messages: u64, entry: Option<&mut CounterEntry>) {
        self.away = self.away.saturating_add(messages);
        update(entry, |entry| entry.away(messages));
    }

    /// Counts a message that has expired. The next message reports what was lost before it.
    pub(super) fn expire(&mut self, delivery: &Delivery<()>, entry: Option<&mut CounterEntry>) {
        self.last_id = delivery.id;
        if let Some(account) = self.account.as_mut().filter(|_| self.unsettled) {
            let missed = account.expire(delivery.id, delivery.lost);
            self.add_away(missed.away, entry);
            let (lost, away) = &mut self.with_expired;
            *lost = lost.saturating_add(missed.lost);
            *away = away.saturating_add(missed.away);
        }
    }
}
