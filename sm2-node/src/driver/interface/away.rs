//! The publishers of a subscriber that have no link for a while, and their publications meanwhile.

use std::sync::Arc;

use sm2_proto::link::Publications;

use super::DeclaredInterface;
use crate::driver::link::LinkDriver;
use crate::driver::token::LinkToken;

impl DeclaredInterface {
    /// The publications that a publisher states in the OPEN of a new link.
    //= SM2-OPN-006
    pub(in crate::driver) const fn publications(&self) -> Publications {
        match self.absence.publisher {
            0 => Publications::UNKNOWN,
            publisher => Publications {
                publisher,
                published: self.published,
            },
        }
    }

    /// Opens the account of a link whose OPEN has come, unless messages of an older link of the publisher are left:
    /// those come first.
    //= SM2-QOS-013
    #[inline]
    pub(super) fn count_absence(&mut self, token: LinkToken) {
        let link = self.links.get_mut(token);
        if let Some(publications) = link.and_then(|it| it.publications_to_account()) {
            self.open_account(token, publications);
        }
    }

    #[cold]
    fn open_account(&mut self, token: LinkToken, publications: Publications) {
        let Some(link) = self.links.get(token) else {
            return;
        };
        let peer = Arc::clone(&link.origin.peer);
        let mut all = self.links.iter();
        let is_first = !all.any(|it| it.token() < token && it.precedes(&peer, publications));
        drop(all);
        let record = match is_first {
            true => (self.absence.publishers).take(&peer.name, publications.publisher),
            false => None,
        };
        let Some(link) = self.links.get_mut(token) else {
            return;
        };
        link.wait_for_older(!is_first);
        if !is_first {
            return;
        }
        let away = link.open_account(publications, record);
        if away > 0 {
            self.reports.count_away(away);
            self.reports.lose(&peer, away);
        }
    }

    /// Removes a link that no message is taken from any more. `dropped` messages of it are lost.
    pub(super) fn remove(&mut self, token: LinkToken, dropped: u64) {
        // An account of a link that waited for an older one until now.
        self.count_absence(token);
        let Some(link) = self.links.remove(token) else {
            return;
        };
        self.for_control.gone.push(token);
        let (lost, away) = link.not_counted();
        self.reports.count_away(away);
        let lost = lost.saturating_add(away).saturating_add(dropped);
        self.reports.lose(&link.origin.peer, lost);
        if let Some((publisher, record)) = link.close_account(dropped) {
            let node = link.origin.peer.name.clone();
            self.absence.publishers.keep(node, publisher, record);
        }
        drop(link);
        self.take_from_waiting();
    }

    /// Opens the accounts of links that waited for the removal of an older link.
    fn take_from_waiting(&mut self) {
        for token in self.links.tokens_of(LinkDriver::waits_for_older) {
            self.count_absence(token);
        }
    }
}
