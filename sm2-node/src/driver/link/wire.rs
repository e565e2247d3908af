//! The socket of a link that is not over, and what waits to be sent through it.
//!
//! The end of a link takes this value out of its driver, so nothing of it can be used later.

use std::io::{self, IoSlice};
use std::mem;
use std::os::fd::{AsFd, OwnedFd};

use sm2_io::{Interest, SegmentFd, SendError, SeqPacket, is_shortage};
use sm2_proto::Code;
use sm2_proto::link::{Attachment, Packet, doorbell};

use crate::driver::event_sets::{BackgroundInterest, LinkSets};
use crate::driver::outbox::{MessageKey, Outbox};
use crate::driver::token::LinkToken;
use crate::link_room::HeldLink;

/// How often in a row calls find that the background thread is woken for packets that it need not read.
const NEEDLESS_WATCHES_MAX: u8 = 16;

#[derive(Debug)]
pub(super) struct Wire {
    /// The room for the socket.
    room: HeldLink,
    pub(super) socket: SeqPacket,
    token: LinkToken,
    /// The file of the ring for messages to this side, until RING is sent.
    pub(super) own_ring: Option<OwnedFd>,
    /// The packet that the socket did not accept.
    pub(super) unsent: Option<Unsent>,
    /// Whether a DOORBELL could not be sent for want of memory.
    is_bell_due: bool,
    /// Whether the kernel had no memory for the last packet, or to read the socket (SM2-TRN-013).
    pub(super) is_short_of_memory: bool,
    /// This side has to end the link with this code.
    pub(super) failing: Option<Code>,
    /// The events that the control side handles.
    in_background: BackgroundInterest,
    /// How often in a row calls found that the control side is woken for packets that it need not read.
    needless_watches: u8,
}

/// A packet that the socket did not accept.
#[derive(Debug)]
pub(super) struct Unsent {
    pub(super) packet: Packet,
    /// The descriptor of an ATTACH. The outbox may close the segment before the socket accepts the
    /// packet.
    pub(super) segment: Option<SegmentFd>,
}

impl Wire {
    pub(super) fn new(
        (socket, room): (SeqPacket, HeldLink),
        token: LinkToken,
        own_ring: Option<OwnedFd>,
    ) -> Self {
        Self {
            room,
            socket,
            token,
            own_ring,
            unsent: None,
            is_bell_due: false,
            is_short_of_memory: false,
            failing: None,
            in_background: BackgroundInterest::Packets,
            needless_watches: 0,
        }
    }

    /// Closes the socket.
    //= SM2-OPN-008
    pub(super) fn close(self, sets: &LinkSets) {
        // Given back before the socket is closed.
        drop(self.room);
        sets.remove_link(&self.socket);
        // A child process may have inherited the socket, so closing it might not tell the other side.
        let _ = self.socket.shutdown();
    }

    /// Offers a packet to the socket.
    pub(super) fn offer(&self, unsent: &Unsent, outbox: &Outbox) -> Result<(), SendError> {
        let Unsent { packet, segment } = unsent;
        let parts = [IoSlice::new(&packet.head), IoSlice::new(&packet.payload)];
        let parts = &parts[..if packet.payload.is_empty() { 1 } else { 2 }];
        let fd = match packet.attachment {
            None => return self.socket.send(parts, &[]),
            Some(Attachment::Segment(_)) => segment.as_ref().map(AsFd::as_fd),
            Some(Attachment::Message(key)) => outbox.sealed_file(MessageKey::from_raw(key)),
            Some(Attachment::Ring) => self.own_ring.as_ref().map(AsFd::as_fd),
        };
        let fd = fd.ok_or_else(|| io::Error::from(io::ErrorKind::NotFound));
        self.socket.send(parts, &[fd.map_err(SendError::Io)?])
    }

    /// Sends a DOORBELL. Without memory for it, sends it when the socket is writable: the other side sleeps, and
    /// nothing else wakes it. Returns whether memory was short. If the socket is full, it is readable at the other
    /// end, so the other side is awake or will wake.
    //= SM2-RNG-012, SM2-TRN-013
    pub(super) fn ring_bell(&mut self) -> bool {
        let sent = self.socket.send(&[IoSlice::new(&doorbell())], &[]);
        let is_short = matches!(sent, Err(SendError::Io(error)) if is_shortage(&error));
        self.is_bell_due |= is_short;
        is_short
    }

    /// Takes the packet and the DOORBELL that wait until the socket is writable. `None` if none waits.
    pub(super) fn take_waiting(&mut self) -> Option<(Option<Unsent>, bool)> {
        let (unsent, is_bell_due) = (self.unsent.take(), mem::take(&mut self.is_bell_due));
        (unsent.is_some() || is_bell_due).then_some((unsent, is_bell_due))
    }

    /// Changes the events that wake calls.
    pub(super) fn watch(&self, interest: Interest, sets: &LinkSets) -> io::Result<()> {
        sets.watch_link(&self.socket, self.token, interest)
    }

    /// The events that nothing but the background thread may be there to handle. `awaits_packets`: the link is opening,
    /// or messages wait for packets of the other side.
    const fn wanted_in_background(&self, awaits_packets: bool) -> BackgroundInterest {
        if self.unsent.is_some() || self.is_bell_due {
            BackgroundInterest::Room
        } else if awaits_packets {
            BackgroundInterest::Packets
        } else {
            BackgroundInterest::End
        }
    }

    /// Whether more than the end of the link wakes the background thread.
    #[inline]
    pub(super) fn wakes_background(&self) -> bool {
        self.in_background != BackgroundInterest::End
    }

    /// Wakes the background thread for the events that it has to handle from now on. A system call for each change
    /// would cost more than a few needless wake-ups. Packets therefore wake the thread until it handles one, or until
    /// calls have read [`NEEDLESS_WATCHES_MAX`] of them before it. `awaits_packets`: as for the events.
    #[inline]
    pub(super) fn watch_in_background(&mut self, awaits_packets: bool, sets: &LinkSets) {
        let wanted = self.wanted_in_background(awaits_packets);
        if wanted != BackgroundInterest::End || self.in_background == BackgroundInterest::Room {
            self.set_background(wanted, sets);
        } else if self.in_background == BackgroundInterest::Packets {
            self.needless_watches += 1;
            if self.needless_watches == NEEDLESS_WATCHES_MAX {
                self.set_background(wanted, sets);
            }
        }
    }

    /// Called when the background thread has handled an event. Stops waking it for packets if no message waits for
    /// them.
    pub(super) fn after_background_event(&mut self, awaits_packets: bool, sets: &LinkSets) {
        self.set_background(self.wanted_in_background(awaits_packets), sets);
    }

    /// Wakes the background thread for these events alone.
    fn set_background(&mut self, wanted: BackgroundInterest, sets: &LinkSets) {
        self.needless_watches = 0;
        if wanted == self.in_background {
            return;
        }
        if (sets.watch_link_in_background(&self.socket, self.token, wanted)).is_ok() {
            self.in_background = wanted;
        }
    }
}
