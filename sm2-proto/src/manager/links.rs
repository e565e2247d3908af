//! All links, each with its two ends and how far their farewells have come.

use alloc::collections::BTreeMap;

use crate::{InterfaceId, NodeId};

/// One end of a link, or an interface anywhere in the domain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct End {
    pub(super) node: NodeId,
    pub(super) interface: InterfaceId,
}

/// How far the farewell of one end has come (SM2-LNK-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum State {
    /// Nobody has said farewell.
    Live,
    /// UNLINK was sent; UNLINKED has not come.
    Told,
    /// Both were said, or the end's interface is gone.
    Gone,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Link {
    ends: [(End, State); 2],
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Links {
    last_serial: u64,
    links: BTreeMap<u64, Link>,
    /// How many have two live ends.
    live: usize,
}

impl Links {
    pub(super) const fn new() -> Self {
        Self {
            last_serial: 0,
            links: BTreeMap::new(),
            live: 0,
        }
    }

    /// A new link's number.
    //= SM2-LNK-002
    pub(super) fn insert(&mut self, one: End, other: End) -> u64 {
        self.last_serial += 1;
        let link = Link {
            ends: [(one, State::Live), (other, State::Live)],
        };
        self.links.insert(self.last_serial, link);
        self.live += 1;
        self.last_serial
    }

    /// Forgets a link that was never made. Its ends that are still there.
    pub(super) fn remove(&mut self, serial: u64) -> impl Iterator<Item = End> + use<> {
        let link = self.links.remove(&serial);
        if link.as_ref().is_some_and(Link::is_live) {
            self.live -= 1;
        }
        let ends = link.into_iter().flat_map(|link| link.ends);
        ends.filter(|&(_, state)| state != State::Gone)
            .map(|(end, _)| end)
    }

    /// An end is gone. Whether it was live until now, so that its own side may
    /// have to be answered and the other side be told.
    pub(super) fn farewell(&mut self, serial: u64, end: End) -> bool {
        let Some(link) = self.links.get_mut(&serial) else {
            return false;
        };
        let both_live = link.is_live();
        let Some(state) = link.state(end) else {
            return false;
        };
        let was_live = *state == State::Live;
        *state = State::Gone;
        if both_live {
            self.live -= 1;
        }
        if link.ends.iter().all(|&(_, state)| state == State::Gone) {
            self.links.remove(&serial);
        }
        was_live
    }

    /// The other end, if it is live and so has to be told now.
    pub(super) fn tell_other(&mut self, serial: u64, end: End) -> Option<End> {
        let link = self.links.get_mut(&serial)?;
        let (other, state) = link.ends.iter_mut().find(|(other, _)| *other != end)?;
        if *state != State::Live {
            return None;
        }
        *state = State::Told;
        Some(*other)
    }

    /// Whether both ends are live.
    pub(super) fn is_live(&self, serial: u64) -> bool {
        self.links.get(&serial).is_some_and(Link::is_live)
    }

    pub(super) const fn live(&self) -> usize {
        self.live
    }

    /// How many ends are not gone.
    pub(super) fn ends(&self) -> usize {
        let ends = self.links.values().flat_map(|link| link.ends);
        ends.filter(|&(_, state)| state != State::Gone).count()
    }
}

impl Link {
    fn is_live(&self) -> bool {
        self.ends.iter().all(|&(_, state)| state == State::Live)
    }

    /// The state of an end that is not gone.
    fn state(&mut self, end: End) -> Option<&mut State> {
        let mut ends = self.ends.iter_mut();
        let (_, state) = ends.find(|(it, state)| *it == end && *state != State::Gone)?;
        Some(state)
    }
}
