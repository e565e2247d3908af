//! One end of a pair: the state machine, its driver, and plain lists of its inputs and outputs.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use sm2_proto::{
    Datagram, FdFacts, Machine,
    link::{
        Attachment, Delivery, Fate, Input, Link, Output, Packet, Payload, SegmentInfo,
        wire::{Form, Frame},
    },
};

use crate::link_support::{NOW, pooled, sealed};

pub(crate) type Wire = VecDeque<(Vec<u8>, Vec<FdFacts>)>;

/// One end: the state machine, its driver, and its inputs and outputs.
pub(crate) struct Driver {
    pub(crate) link: Link,
    /// Datagrams of this end that the other end has not read.
    pub(crate) wire: Wire,
    /// The packet that the full socket refused.
    pub(crate) kept: Option<Packet>,
    pub(crate) full: bool,
    pub(crate) sent: Vec<Sent>,
    pub(crate) next_id: u64,
    /// Messages that the application has taken and not released.
    pub(crate) held: Vec<Delivery>,
    /// The ids of all messages that the application has taken.
    pub(crate) taken: Vec<u64>,
    /// The id of the first message that arrived at this end.
    pub(crate) first_seen: Option<u64>,
    /// Segments that the other end has attached here.
    pub(crate) mapped: BTreeMap<u32, SegmentInfo>,
    pub(crate) kept_files: BTreeSet<u64>,
    pub(crate) discards: usize,
    /// Calls without a reply: the ones taken by a server, or made by a caller.
    pub(crate) open_calls: BTreeSet<u64>,
    pub(crate) failed_calls: BTreeSet<u64>,
    pub(crate) cancelled: BTreeSet<u64>,
    pub(crate) skipped: u64,
    pub(crate) ended: bool,
}

/// A message in the sender's list.
pub(crate) struct Sent {
    pub(crate) key: u64,
    pub(crate) id: u64,
    pub(crate) slot: Option<(u32, u32)>,
    pub(crate) left: bool,
    pub(crate) fate: Option<Fate>,
}

impl Driver {
    pub(crate) fn new(link: Link) -> Self {
        Self {
            link,
            wire: Wire::new(),
            kept: None,
            full: false,
            sent: Vec::new(),
            next_id: 0,
            held: Vec::new(),
            taken: Vec::new(),
            first_seen: None,
            mapped: BTreeMap::new(),
            kept_files: BTreeSet::new(),
            discards: 0,
            open_calls: BTreeSet::new(),
            failed_calls: BTreeSet::new(),
            cancelled: BTreeSet::new(),
            skipped: 0,
            ended: false,
        }
    }

    pub(crate) fn observe(&mut self, output: Output) {
        assert!(!self.ended, "nothing comes after Ended: {output:?}");
        match output {
            Output::Transmit(packet) if self.full => {
                assert!(self.kept.is_none(), "one packet is kept at a time");
                self.mark(&packet);
                self.kept = Some(packet);
                let _ = self.link.handle(NOW, Input::Blocked);
            }
            Output::Transmit(packet) => {
                assert!(
                    self.kept.is_none(),
                    "nothing overtakes the packet that is kept"
                );
                self.mark(&packet);
                self.put(&packet);
            }
            Output::Ring(_) => panic!("no ring was offered"),
            Output::Opened => assert!(self.link.is_open() || self.link.end().is_some()),
            Output::Attach {
                segment,
                stride,
                slots,
            } => {
                let info = SegmentInfo {
                    id: segment,
                    stride,
                    slots,
                };
                assert!(self.mapped.insert(segment, info).is_none() && self.mapped.len() <= 256);
            }
            Output::Detach { segment } => {
                let uses = |it: &Delivery| match it.payload {
                    Payload::Pooled { segment: used, .. } => used == segment,
                    Payload::Inline(_) | Payload::Cell(_) | Payload::Sealed => false,
                };
                assert!(!self.held.iter().any(uses));
                assert!(self.mapped.remove(&segment).is_some());
            }
            Output::Keep { sequence } => assert!(self.kept_files.insert(sequence)),
            Output::Discard { .. } => self.discards += 1,
            Output::Settled { key, fate } => {
                let sent = self.sent.iter_mut().find(|it| it.key == key).unwrap();
                assert_eq!(sent.fate.replace(fate), None, "settled once");
            }
            Output::Cancelled { call } => assert!(self.cancelled.insert(call)),
            Output::CallFailed { call } => {
                assert!(self.open_calls.remove(&call));
                self.failed_calls.insert(call);
            }
            Output::Ended(_) => {
                self.ended = true;
                self.kept = None;
            }
        }
    }

    /// Marks a message as sent: its packet was handed out.
    fn mark(&mut self, packet: &Packet) {
        if matches!(packet.head[0], 4..=6) {
            let id = u64::from_le_bytes(packet.head[24..32].try_into().unwrap());
            self.sent
                .iter_mut()
                .find(|it| it.id == id && !it.left)
                .unwrap()
                .left = true;
        }
    }

    /// Hands a packet to the socket, with the facts about its descriptor.
    pub(crate) fn put(&mut self, packet: &Packet) {
        let bytes = packet.to_vec();
        let fds = match packet.attachment {
            None => vec![],
            Some(Attachment::Segment(id)) => {
                vec![pooled(segment(id).stride * u64::from(SLOTS))]
            }
            Some(Attachment::Message(_)) => vec![sealed(4096)],
            Some(Attachment::Ring) => panic!("no ring was offered"),
        };
        let datagram = Datagram {
            bytes: &bytes,
            fds: &fds,
            ..Datagram::default()
        };
        let frame = Frame::decode(&datagram).unwrap();
        if let Frame::Message(message) = frame {
            assert!(!self.link.config().sealed || !matches!(message.form, Form::Pooled { .. }));
        }
        self.wire.push_back((bytes, fds));
    }

    pub(crate) fn calls_are_answered(&self) -> bool {
        self.open_calls.is_empty() && self.link.calls() == 0
    }
}

pub(crate) const SLOTS: u32 = 2;

pub(crate) fn segment(id: u32) -> SegmentInfo {
    SegmentInfo {
        id,
        stride: 4096 * (1 + u64::from(id)),
        slots: SLOTS,
    }
}
