//! The rings, slots and sockets between the two ends of a link of a service.
#![allow(dead_code, reason = "each test binary uses its part")]

use std::{
    cell::RefCell,
    collections::{BTreeMap, VecDeque},
};

use sm2_proto::{
    FdFacts,
    limits::SLOT_HEAD,
    link::{Attachment, Packet, SegmentInfo, Status},
};

use crate::{
    link_support::{pooled, ring_file},
    ring_support::Memory,
};

pub(crate) const SLOTS: u32 = 8;

pub(crate) const fn segment(id: u32) -> SegmentInfo {
    SegmentInfo {
        id,
        stride: 4096,
        slots: SLOTS,
    }
}

/// A datagram and the facts about its descriptors.
type Wired = (Vec<u8>, Vec<FdFacts>);

/// The shared state between the two ends.
pub(crate) struct World {
    /// One ring for replies and one for requests, indexed by the end that takes messages from it.
    pub(crate) rings: [Memory; 2],
    /// The heads of all slots, by writing end, segment and slot.
    pub(crate) heads: RefCell<BTreeMap<(usize, u32, u32), [u8; SLOT_HEAD]>>,
    /// The datagrams that each end has sent and the other end has not read.
    pub(crate) wires: RefCell<[VecDeque<Wired>; 2]>,
    /// The status of the reply to each call.
    pub(crate) replied: RefCell<BTreeMap<u64, Status>>,
}

impl World {
    pub(crate) fn put(&self, end: usize, packet: &Packet) {
        let fds = match packet.attachment {
            None => vec![],
            Some(Attachment::Ring) => vec![ring_file(self.rings[end].layout.size_bytes())],
            Some(Attachment::Segment(_)) => vec![pooled(4096 * u64::from(SLOTS))],
            Some(Attachment::Message(_)) => panic!("no sealed messages here"),
        };
        self.wires.borrow_mut()[end].push_back((packet.to_vec(), fds));
    }

    pub(crate) fn is_readable(&self, end: usize) -> bool {
        !self.wires.borrow()[1 - end].is_empty()
    }

    pub(crate) fn copy(&self, from: usize, segment: u32, offset: u64) -> Option<[u8; SLOT_HEAD]> {
        let place = (from, segment, (offset / 4096) as u32);
        self.heads.borrow().get(&place).copied()
    }
}
