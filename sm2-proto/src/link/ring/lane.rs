//! The state of a link whose messages are sent through rings.

use super::{
    super::{
        Attachment, Config, Counters, Packet, frame_kind::Carrier, segments::SegmentFrame,
        wire::Frame,
    },
    At, RingLayout, RingReceiver, RingSegments, RingSender,
    message::RingMessage,
    send_queue::SendQueue,
};
use crate::{Period, Violation};

/// The rings of a link: one for each direction where its role has messages.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(in crate::link) struct RingLane {
    outgoing: Option<Outgoing>,
    pub(in crate::link) incoming: Option<RingReceiver>,
    /// The segments of the other end.
    pub(in crate::link) segments: RingSegments,
    /// Caller or server: messages that are queued until the outgoing ring has room.
    pub(in crate::link) queue: SendQueue,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
#[allow(
    clippy::large_enum_variant,
    reason = "every open ring is here, and a box would cost each message a load"
)]
enum Outgoing {
    /// The other end's RING has not come yet. `window` is from its OPEN.
    Awaited {
        window: u32,
    },
    Here(RingSender),
}

impl RingLane {
    /// Creates the lane after both ends have offered it in OPEN; `window` is from the other end's
    /// OPEN.
    //= SM2-RNG-001, SM2-RNG-002
    pub(in crate::link) fn new(config: &Config, window: u32) -> Self {
        let incoming = config.ring_layout().map(|layout| {
            let carrier = Carrier::to(config.role);
            RingReceiver::new(
                layout,
                carrier,
                config.reliable,
                config.lifespan != Period::NONE,
                config.max_borrowed,
                config.max_len,
            )
        });
        Self {
            outgoing: (config.role.sends()).then_some(Outgoing::Awaited { window }),
            incoming,
            segments: RingSegments::default(),
            queue: SendQueue::default(),
        }
    }

    /// The layout of the incoming ring, which this end creates.
    pub(in crate::link) fn layout(&self) -> Option<RingLayout> {
        self.incoming.as_ref().map(RingReceiver::layout)
    }

    /// Handles RING, which has a ring of this layout.
    //= SM2-RNG-002
    pub(in crate::link) fn on_ring(
        &mut self,
        config: &Config,
        layout: RingLayout,
    ) -> Result<(), Violation> {
        match &mut self.outgoing {
            Some(outgoing) if outgoing.awaits(layout.window()) => {
                let carrier = Carrier::to(config.role.counterpart());
                let expires = config.lifespan != Period::NONE;
                let sender = RingSender::new(layout, carrier, config.reliable, expires);
                *outgoing = Outgoing::Here(sender);
                Ok(())
            }
            _ => Err(violation!(BadRing, "SM2-RNG-002")),
        }
    }

    /// Handles DETACH.
    //= SM2-RNG-009
    pub(in crate::link) fn on_detach(&mut self, segment: u32) -> Result<(), Violation> {
        if self.incoming.as_ref().is_some_and(|it| it.holds(segment)) {
            return Err(violation!(SegmentBusy, "SM2-SEG-005"));
        }
        self.segments.detach(segment)
    }

    /// Handles DETACHED.
    //= SM2-RNG-009
    pub(in crate::link) fn on_detached(&mut self, segment: u32) -> Result<(), Violation> {
        let sender = self.sender_mut();
        let sender = sender.ok_or(violation!(UnknownSegment, "SM2-RNG-009"))?;
        sender.segments.detached(segment)
    }

    /// Returns the next frame that has to be sent over the socket.
    //= SM2-RNG-009
    pub(in crate::link) fn poll(&mut self) -> Option<Packet> {
        if let Some(segment) = self.segments.poll_detached() {
            return Some(Packet::bare(Frame::Detached { segment }.head()));
        }
        Some(match self.sender_mut()?.segments.poll()? {
            SegmentFrame::Attach(info) => Packet {
                attachment: Some(Attachment::Segment(info.id)),
                ..Packet::bare(Frame::Attach(info).head())
            },
            SegmentFrame::Detach(segment) => Packet::bare(Frame::Detach { segment }.head()),
        })
    }

    /// Whether [`poll`](Self::poll) returns a frame.
    #[inline]
    pub(in crate::link) fn has_packets(&self) -> bool {
        self.segments.has_detached() || self.sender().is_some_and(|it| it.segments.has_steps())
    }

    /// Ends the lane with its link. Passes the keys of all messages that were not settled to
    /// `each`.
    pub(in crate::link) fn end(&mut self, by_violation: bool, mut each: impl FnMut(u64)) {
        if let Some(Outgoing::Here(sender)) = &mut self.outgoing {
            sender.end(&mut each);
            self.queue.end(|key| {
                sender.count_closed();
                each(key);
            });
        }
        if let Some(receiver) = &mut self.incoming {
            receiver.end(by_violation);
        }
    }

    /// The word where this end announces that it sleeps. A caller or server uses its incoming
    /// ring.
    pub(in crate::link) fn parked_word(&self) -> Option<At> {
        match self.incoming {
            Some(_) => Some(At::ReceiverParked),
            None => self.sender().map(|_| At::SenderParked),
        }
    }

    /// Whether the other end's RING has not come yet.
    #[inline]
    pub(in crate::link) const fn is_awaited(&self) -> bool {
        matches!(self.outgoing, Some(Outgoing::Awaited { .. }))
    }

    /// The sender's side of the outgoing ring, once RING has come.
    #[inline]
    pub(in crate::link) const fn sender(&self) -> Option<&RingSender> {
        match &self.outgoing {
            Some(Outgoing::Here(sender)) => Some(sender),
            _ => None,
        }
    }

    #[inline]
    pub(in crate::link) const fn sender_mut(&mut self) -> Option<&mut RingSender> {
        match &mut self.outgoing {
            Some(Outgoing::Here(sender)) => Some(sender),
            _ => None,
        }
    }

    /// The sender's side of the outgoing ring and the messages that are queued for it.
    pub(in crate::link) const fn sender_and_queue(
        &mut self,
    ) -> Option<(&mut RingSender, &mut SendQueue)> {
        match &mut self.outgoing {
            Some(Outgoing::Here(sender)) => Some((sender, &mut self.queue)),
            _ => None,
        }
    }

    /// Counts of the messages by outcome, including queued messages.
    #[inline]
    pub(in crate::link) fn counters(&self) -> Counters {
        let queued = self.queue.len() as u64;
        let sent = self.sender().map(RingSender::counters).unwrap_or_default();
        Counters {
            offered: sent.offered + queued,
            in_flight: sent.in_flight + queued,
            ..sent
        }
    }

    pub(in crate::link) fn in_flight(&self) -> usize {
        self.sender().map_or(0, RingSender::in_flight) + self.queue.len()
    }

    #[inline]
    pub(in crate::link) fn owes(&self) -> bool {
        self.sender().is_some_and(RingSender::owes)
    }

    /// Whether the first queued message has an attached segment and the ring was not found full.
    pub(in crate::link) fn is_due(&self) -> bool {
        let is_attached = |it: &RingMessage| {
            let sender = self.sender();
            sender.is_some_and(|sender| sender.segments.is_attached(&it.segment))
        };
        !self.queue.is_full && self.queue.front().is_some_and(is_attached)
    }

    pub(in crate::link) fn has_queued(&self) -> bool {
        self.queue.len() > 0
    }

    /// The id of the last message that a caller or server queued.
    pub(in crate::link) const fn last_id(&self) -> Option<u64> {
        self.queue.last_id()
    }

    /// How many messages the incoming ring can hold.
    pub(in crate::link) fn depth(&self) -> usize {
        self.layout().map_or(0, |it| usize::from(it.depth()))
    }

    /// Checks the invariants, which hold after each call.
    #[inline]
    pub(in crate::link) fn invariants(&self) {
        if let Some(sender) = self.sender() {
            sender.invariants();
        }
        if let Some(receiver) = &self.incoming {
            receiver.invariants();
        }
        self.queue.invariants();
    }
}

impl Outgoing {
    const fn awaits(&self, its: u32) -> bool {
        matches!(self, Self::Awaited { window } if *window == its)
    }
}
