//! The publishers of a subscriber that have no link for a while, and their publications meanwhile.

use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::sync::Arc;

use sm2_proto::Contract;
use sm2_proto::link::{Absences, Publications};

use super::links::Links;
use super::reports::Reports;
use crate::driver::link::LinkDriver;
use crate::driver::token::LinkToken;

/// The knowledge of an interface about publications while a publisher and a subscriber have no link.
#[derive(Debug)]
pub(in crate::driver) struct Absence {
    /// A publisher's number, which it says in OPEN. 0 at all other interfaces.
    publisher: u64,
    /// A subscriber's publishers without a link.
    publishers: Absences,
}

impl Absence {
    pub(super) fn of(contract: &Contract) -> Self {
        let publisher = match contract {
            // Each `RandomState` has other keys, so its hash of nothing is a random number.
            Contract::Publisher { .. } => RandomState::new().build_hasher().finish().max(1),
            _ => 0,
        };
        Self {
            publisher,
            publishers: Absences::default(),
        }
    }

    /// The statement of a publisher that has published this many messages, for the OPEN of a new link.
    //= SM2-OPN-006
    pub(in crate::driver) const fn publications(&self, published: u64) -> Publications {
        match self.publisher {
            0 => Publications::UNKNOWN,
            publisher => Publications {
                publisher,
                published,
            },
        }
    }

    /// Opens the account of a link whose OPEN has come, unless messages of an older link of the publisher are left:
    /// those come first.
    //= SM2-QOS-013
    #[inline]
    pub(super) fn count(&mut self, token: LinkToken, links: &mut Links, reports: &mut Reports) {
        let link = links.get_mut(token);
        if let Some(publications) = link.and_then(|it| it.publications_to_account()) {
            self.open_account(token, publications, links, reports);
        }
    }

    #[cold]
    fn open_account(
        &mut self,
        token: LinkToken,
        publications: Publications,
        links: &mut Links,
        reports: &mut Reports,
    ) {
        let Some(link) = links.get(token) else {
            return;
        };
        let peer = Arc::clone(&link.origin.peer);
        let mut all = links.iter();
        let is_first = !all.any(|it| it.token() < token && it.precedes(&peer, publications));
        drop(all);
        let record = match is_first {
            true => (self.publishers).take(&peer.name, publications.publisher),
            false => None,
        };
        let Some(link) = links.get_mut(token) else {
            return;
        };
        link.wait_for_older(!is_first);
        if !is_first {
            return;
        }
        let away = link.open_account(publications, record);
        reports.lose(&peer, away, away);
    }

    /// Closes the account of a link that was removed, and opens those of links that waited for that. `dropped` messages
    /// of the link are lost.
    pub(super) fn close_account(
        &mut self,
        link: &LinkDriver,
        dropped: u64,
        links: &mut Links,
        reports: &mut Reports,
    ) {
        let (lost, away) = link.not_counted();
        let lost = lost.saturating_add(away).saturating_add(dropped);
        reports.lose(&link.origin.peer, lost, away);
        if let Some((publisher, record)) = link.close_account(dropped) {
            let node = link.origin.peer.name.clone();
            self.publishers.keep(node, publisher, record);
        }
        for token in links.tokens_of(LinkDriver::waits_for_older) {
            self.count(token, links, reports);
        }
    }
}
