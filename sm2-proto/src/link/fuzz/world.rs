//! The driver and the peer of one machine, reduced to the state that they need for checks.

use alloc::{
    collections::{BTreeMap, BTreeSet},
    vec,
    vec::Vec,
};

use super::{
    super::{
        Config, Delivery, End, Error, Input, LaneKind, Link, MaxLen, Output, Packet, Payload,
        Publications, Role, wire::Frame,
    },
    LINK, NOW,
};
use crate::{Datagram, FdFacts, Machine, Period, fuzz::Script};

/// One machine, and the state of its driver and its peer.
pub(super) struct World {
    pub(super) link: Link,
    pub(super) blocked: bool,
    pub(super) end: Option<End>,
    /// The keys of the messages that the machine accepted and did not settle.
    pub(super) pending: BTreeSet<u64>,
    /// How many messages in cells can still be unsettled. They have no keys.
    pub(super) in_cells: usize,
    /// The sequence numbers that the machine sent and the peer has not released.
    pub(super) sent: BTreeSet<u64>,
    /// The sequence numbers that the application holds.
    pub(super) held: BTreeSet<u64>,
    /// The sizes of the segments that the driver has mapped.
    pub(super) mapped: BTreeMap<u32, u64>,
    /// The last sequence number and id that the peer used.
    pub(super) peer: (u64, u64),
    /// The last key and id that the application used.
    pub(super) own: u64,
    /// The ids of the calls that the machine received or made.
    pub(super) calls: Vec<u64>,
    /// The calls that the machine reported as failed or as cancelled.
    pub(super) failed: Vec<u64>,
    pub(super) cancelled: Vec<u64>,
}

impl World {
    /// Creates the machine with a configuration from the bytes; `None` if there are too few bytes.
    pub(super) fn new(script: &mut Script<'_>) -> Option<Self> {
        let flags = script.byte()?;
        let config = Config {
            id: LINK,
            version: 1,
            role: Role::ALL[usize::from(flags & 3)],
            reliable: flags & 4 != 0,
            sealed: flags & 8 != 0,
            ring: flags & 16 != 0,
            depth: u16::from(script.byte()? % 4),
            max_borrowed: u16::from(script.byte()? % 4),
            max_len: match flags & 32 {
                0 => MaxLen::GREATEST,
                _ => MaxLen::LEAST,
            },
            deadline: Period(u64::from(flags >> 6)),
            lifespan: Period(u64::from(flags & 32)),
            lease: Period(u64::from(flags >> 5 & 3)),
            publications: Publications::UNKNOWN,
        };
        Some(Self::with(config))
    }

    /// Creates a machine that has sent its OPEN.
    pub(super) fn with(config: Config) -> Self {
        let mut world = Self {
            link: Link::new(config),
            blocked: false,
            end: None,
            pending: BTreeSet::new(),
            in_cells: 0,
            sent: BTreeSet::new(),
            held: BTreeSet::new(),
            mapped: BTreeMap::new(),
            peer: (0, 0),
            own: 0,
            calls: Vec::new(),
            failed: Vec::new(),
            cancelled: Vec::new(),
        };
        world.drain();
        world
    }

    pub(super) fn datagram(&mut self, bytes: &[u8], fds: &[FdFacts]) {
        self.input(Input::Datagram(Datagram {
            bytes,
            fds,
            ..Datagram::default()
        }));
    }

    pub(super) fn input(&mut self, input: Input<'_>) {
        match input {
            Input::Blocked => self.blocked = true,
            Input::Writable => self.blocked = false,
            _ => {}
        }
        let _ = self.feed(input);
        self.drain();
    }

    pub(super) fn feed(&mut self, input: Input<'_>) -> Result<(), Error> {
        let before = self.link.clone();
        let result = self.link.handle(NOW, input);
        self.check(&before, result);
        result
    }

    /// Checks the result of a call against the change of the machine's state.
    pub(super) fn check(&self, before: &Link, result: Result<(), Error>) {
        match result {
            Ok(()) => {}
            Err(Error::Misuse(misuse)) => {
                assert_eq!(self.link, *before, "misuse changes nothing: {misuse}");
            }
            Err(Error::Ended(end)) => {
                assert_eq!(self.link.end(), Some(end));
                assert!(before.end().is_none_or(|first| first == end));
            }
        }
    }

    pub(super) fn drain(&mut self) {
        while let Some(output) = self.link.poll() {
            // Replies in a ring can be taken after the end, so `CallFailed` may follow `Ended`
            // there.
            let is_late =
                self.link.lane() == LaneKind::Ring && matches!(output, Output::CallFailed { .. });
            assert!(self.end.is_none() || is_late, "nothing comes after Ended");
            self.observe(output);
        }
        assert_eq!(self.end, self.link.end());
        let in_flight = self.link.in_flight();
        let in_cells = in_flight.checked_sub(self.pending.len());
        let in_cells = in_cells.expect("a message is in flight until it is settled");
        assert!(in_cells <= self.in_cells, "{in_cells} in cells");
        assert!(in_flight == 0 || self.end.is_none());
        self.in_cells = in_cells;
        let it = self.link.counters();
        assert_eq!(it.offered, it.delivered + it.dropped() + it.in_flight);
        assert_eq!(it.in_flight, in_flight as u64);
    }

    fn observe(&mut self, output: Output) {
        match output {
            Output::Transmit(packet) => self.observe_packet(&packet),
            Output::Settled { key, .. } => assert!(self.pending.remove(&key), "settled once"),
            Output::Attach {
                segment,
                stride,
                slots,
            } => {
                assert!(
                    self.mapped
                        .insert(segment, stride * u64::from(slots))
                        .is_none()
                );
            }
            Output::Detach { segment } => assert!(self.mapped.remove(&segment).is_some()),
            Output::Ended(end) => {
                assert!(self.pending.is_empty());
                self.end = Some(end);
            }
            Output::Opened | Output::Ring(_) | Output::Keep { .. } | Output::Discard { .. } => {}
            Output::Cancelled { call } => self.cancelled.push(call),
            Output::CallFailed { call } => self.failed.push(call),
        }
    }

    /// Checks that the machine sends a frame that its peer may receive.
    fn observe_packet(&mut self, packet: &Packet) {
        assert!(!self.blocked, "nothing is sent while the socket is blocked");
        let bytes = packet.to_vec();
        assert_eq!(bytes.len(), packet.len_bytes());
        let fds = vec![FdFacts::default(); usize::from(packet.attachment.is_some())];
        let datagram = Datagram {
            bytes: &bytes,
            fds: &fds,
            ..Datagram::default()
        };
        let frame = Frame::decode(&datagram).expect("what is sent is a frame");
        assert_eq!(frame.check_length(), Ok(()));
        assert!(
            frame
                .kind()
                .is_received_by(self.link.config().role.counterpart())
        );
        assert!(self.link.end().is_none() || matches!(frame, Frame::Close(_)));
        if let Frame::Message(message) = frame {
            assert!(message.len <= self.link.peer_max_len());
            assert!(self.sent.insert(message.sequence));
        }
    }

    pub(super) fn check_delivery(&self, delivery: &Delivery) {
        assert!(delivery.len <= self.link.config().max_len.bytes());
        match &delivery.payload {
            Payload::Inline(bytes) => assert_eq!(bytes.len() as u64, delivery.len),
            Payload::Pooled { segment, offset } => {
                assert!(!self.link.config().sealed);
                assert!(
                    self.mapped
                        .get(segment)
                        .is_some_and(|size| offset + delivery.len <= *size)
                );
            }
            Payload::Cell(bytes) => {
                assert_eq!(bytes.len() as u64, delivery.len);
                assert!(!self.link.config().sealed);
            }
            Payload::Sealed => {}
        }
    }
}
