//! The rings of one link: which of them it has, by its role.

use super::{
    super::{Counters, Fate},
    At, RingReceiver, RingSender,
    service::Waiting,
};

/// Where a link of the ring lane has its messages: a ring for each direction that its role has.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(in crate::link) struct Ring {
    pub(super) outgoing: Option<Outgoing>,
    pub(super) incoming: Option<RingReceiver>,
    /// Of a caller or server: what there was no room for.
    pub(super) waiting: Waiting,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Outgoing {
    /// The other end, with this window, has not sent RING yet.
    Awaited {
        window: u32,
    },
    Here(RingSender),
}

impl Ring {
    pub(super) fn new(outgoing: Option<Outgoing>, incoming: Option<RingReceiver>) -> Self {
        Self {
            outgoing,
            incoming,
            waiting: Waiting::default(),
        }
    }

    /// The link is over. Gives the keys of what was sent and is not settled.
    pub(in crate::link) fn end(&mut self, by_violation: bool, mut each: impl FnMut(u64)) {
        if let Some(Outgoing::Here(sender)) = &mut self.outgoing {
            sender.end(&mut each);
            self.waiting.end(|key| {
                sender.skip(Fate::Closed);
                each(key);
            });
        }
        if let Some(receiver) = &mut self.incoming {
            receiver.end(by_violation);
        }
    }

    /// The word by which this end says that it sleeps. A caller or server: in its incoming ring.
    pub(in crate::link) fn parked_word(&self) -> Option<At> {
        match self {
            Self {
                incoming: Some(_), ..
            } => Some(At::ReceiverParked),
            ring => ring.sender().map(|_| At::SenderParked),
        }
    }

    /// Whether the other end's RING is still to come.
    pub(in crate::link) const fn is_awaited(&self) -> bool {
        matches!(self.outgoing, Some(Outgoing::Awaited { .. }))
    }

    #[inline]
    pub(in crate::link) const fn sender(&self) -> Option<&RingSender> {
        match &self.outgoing {
            Some(Outgoing::Here(sender)) => Some(sender),
            _ => None,
        }
    }

    #[inline]
    pub(super) const fn sender_mut(&mut self) -> Option<&mut RingSender> {
        match &mut self.outgoing {
            Some(Outgoing::Here(sender)) => Some(sender),
            _ => None,
        }
    }

    /// What became of the messages, also of those that wait.
    #[inline]
    pub(in crate::link) fn counters(&self) -> Counters {
        let waiting = self.waiting.len() as u64;
        let sent = self.sender().map(RingSender::counters).unwrap_or_default();
        Counters {
            offered: sent.offered + waiting,
            in_flight: sent.in_flight + waiting,
            ..sent
        }
    }

    pub(in crate::link) fn in_flight(&self) -> usize {
        self.sender().map_or(0, RingSender::in_flight) + self.waiting.len()
    }

    /// What must hold between any two calls.
    #[inline]
    pub(in crate::link) fn invariants(&self) {
        if let Some(sender) = self.sender() {
            sender.invariants();
        }
        if let Some(receiver) = &self.incoming {
            receiver.invariants();
        }
        self.waiting.invariants();
    }
}

impl Outgoing {
    pub(super) fn awaits(&self, its: u32) -> bool {
        matches!(self, Self::Awaited { window } if *window == its)
    }
}

/// The sender of a link's outgoing ring, once it is there.
#[inline]
pub(in crate::link) fn sender_of(ring: &mut Option<Ring>) -> Option<&mut RingSender> {
    ring.as_mut()?.sender_mut()
}

/// The receiver of a link's incoming ring.
#[inline]
pub(in crate::link) fn receiver_of(ring: &mut Option<Ring>) -> Option<&mut RingReceiver> {
    ring.as_mut()?.incoming.as_mut()
}
