//! Opening and closing the account of a link, for its interface.

use sm2_proto::control::LinkPeer;
use sm2_proto::link::{Account, Publications, Record};
use sm2_proto::{Contract, Farewell};

use super::LinkDriver;

impl LinkDriver {
    /// The publications that the publisher of a subscriber's link states, until the account is open.
    #[inline]
    pub(in crate::driver) fn publications_to_account(&self) -> Option<Publications> {
        let publications = self.machine.peer_publications();
        (!publications.is_unknown() && self.account.account.is_none()).then_some(publications)
    }

    /// Whether the messages of this link, which is over, have to be taken before those of a link with this publisher.
    pub(in crate::driver) fn precedes(&self, peer: &LinkPeer, of: Publications) -> bool {
        self.end().is_some()
            && self.machine.peer_publications().publisher == of.publisher
            && self.origin.peer.name == peer.name
    }

    /// Takes no message from this link until those of an older link are taken, or takes them now.
    pub(in crate::driver) const fn wait_for_older(&mut self, waits: bool) {
        self.account.waits_for_older = waits;
    }

    /// Whether messages of an older link come first.
    #[inline]
    pub(in crate::driver) const fn waits_for_older(&self) -> bool {
        self.account.waits_for_older
    }

    /// Opens the account. Returns how many messages were published while the publisher had no link, and counts them for
    /// this link.
    //= SM2-QOS-013
    pub(in crate::driver) fn open_account(
        &mut self,
        publications: Publications,
        record: Option<Record>,
    ) -> u64 {
        let is_latched = match &self.origin.peer.contract {
            Contract::Publisher { offer, .. } => offer.latched > 0,
            _ => false,
        };
        let (account, away) = Account::open(publications, is_latched, record);
        self.account.account = Some(account);
        self.account.unsettled = true;
        self.account.add_away(away, self.entry.as_mut());
        away
    }

    /// Ends the account of a link that is removed. Returns what is remembered of its publisher: nothing if the
    /// publisher is gone. `dropped` messages of the link were counted as lost.
    //= SM2-QOS-013
    pub(in crate::driver) fn close_account(&self, dropped: u64) -> Option<(u64, Record)> {
        let is_gone = self.end_code() == Some(Farewell::Done.code());
        let account = self.account.account.filter(|_| !is_gone)?;
        let (lost, away) = self.not_counted();
        let last_id = (self.account.last_id > 0).then_some(self.account.last_id);
        let publisher = self.machine.peer_publications().publisher;
        Some((
            publisher,
            account.close(last_id, dropped, lost.saturating_add(away)),
        ))
    }

    /// The losses before messages that have expired and that no later message has reported: on the link, and while the
    /// publisher had no link.
    pub(in crate::driver) const fn not_counted(&self) -> (u64, u64) {
        match self.account.unsettled {
            true => self.account.with_expired,
            false => (self.lost_with_expired, 0),
        }
    }
}
