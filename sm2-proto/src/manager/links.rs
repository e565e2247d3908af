//! The links that are live at both ends, and whose they are.

use alloc::collections::BTreeMap;

use crate::{InterfaceId, LinkId, NodeId};

/// One end of a link, or an interface anywhere in the domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct End {
    pub(super) node: NodeId,
    pub(super) interface: InterfaceId,
}

/// What a farewell still has to reach is each session's to know
/// ([`Session`](super::session::Session)): here a link ends with the first one.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Links {
    epoch: u64,
    last_serial: u64,
    live: BTreeMap<LinkId, [End; 2]>,
}

impl Links {
    pub(super) const fn new(epoch: u64) -> Self {
        Self {
            epoch,
            last_serial: 0,
            live: BTreeMap::new(),
        }
    }

    pub(super) const fn epoch(&self) -> u64 {
        self.epoch
    }

    //= SM2-LNK-002
    pub(super) fn insert(&mut self, ends: [End; 2]) -> LinkId {
        self.last_serial += 1;
        let link = LinkId {
            epoch: self.epoch,
            serial: self.last_serial,
        };
        self.live.insert(link, ends);
        link
    }

    /// The ends of a link that was live until now.
    pub(super) fn remove(&mut self, link: LinkId) -> Option<[End; 2]> {
        self.live.remove(&link)
    }

    /// Forgets all links; their numbers stay spent.
    pub(super) fn clear(&mut self) {
        self.live.clear();
    }

    pub(super) fn len(&self) -> usize {
        self.live.len()
    }
}
