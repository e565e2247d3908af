//! Both ends of the link together.

use std::cell::RefCell;

use sm2_proto::{
    Machine,
    link::{End, Input, Role},
};

use super::{CALLER, SERVER, Side};
use crate::{
    link_support::NOW,
    ring_support::world::World,
    ring_support::{Memory, ring_config},
};

/// Both ends, and the world between them.
pub(crate) struct Calls {
    pub(crate) world: World,
    pub(crate) caller: Side,
    pub(crate) server: Side,
}

impl Calls {
    /// Both ends, before they have read any frame.
    pub(crate) fn fresh(depth: [u16; 2], max_borrowed: [u16; 2]) -> Self {
        let config = |end, role| ring_config(role, true, depth[end], max_borrowed[end]);
        let configs = [config(CALLER, Role::Caller), config(SERVER, Role::Server)];
        let mut pair = Self {
            world: World {
                rings: configs.map(|it| Memory::new(it.ring_layout().unwrap())),
                heads: RefCell::default(),
                wires: RefCell::default(),
                replied: RefCell::default(),
            },
            caller: Side::new(CALLER, configs[CALLER]),
            server: Side::new(SERVER, configs[SERVER]),
        };
        pair.caller.drain(&pair.world);
        pair.server.drain(&pair.world);
        pair
    }

    /// Open ends, with both rings.
    pub(crate) fn open(depth: [u16; 2], max_borrowed: [u16; 2]) -> Self {
        let mut pair = Self::fresh(depth, max_borrowed);
        pair.pump();
        assert!(pair.caller.link.is_open() && pair.server.link.is_open());
        pair
    }

    /// Lets both ends read all datagrams.
    pub(crate) fn pump(&mut self) {
        while self.world.is_readable(CALLER) || self.world.is_readable(SERVER) {
            self.read(CALLER);
            self.read(SERVER);
        }
    }

    pub(crate) fn side(&mut self, end: usize) -> (&mut Side, &World) {
        match end {
            CALLER => (&mut self.caller, &self.world),
            _ => (&mut self.server, &self.world),
        }
    }

    pub(crate) fn read(&mut self, end: usize) {
        let is_over = self.side(1 - end).0.ended;
        let (side, world) = self.side(end);
        side.read(world, is_over);
    }

    /// Makes a call.
    pub(crate) fn call(&mut self) {
        self.call_within(Some(0));
    }

    /// Makes a call in a slot of this segment, or in a cell.
    pub(crate) fn call_within(&mut self, within: Option<u32>) {
        (self.caller).call(&self.world.rings[SERVER], &self.world, within);
    }

    /// Lets the server reply to the oldest call.
    pub(crate) fn reply(&mut self) {
        self.reply_within(Some(0));
    }

    /// Lets the server reply to the oldest call, in a slot of this segment or in a cell.
    pub(crate) fn reply_within(&mut self, within: Option<u32>) {
        (self.server).reply(&self.world.rings[CALLER], &self.world, 0, within);
    }

    pub(crate) fn take(&mut self, end: usize) {
        let (side, world) = self.side(end);
        if !side.take(&world.rings[end], world) {
            return;
        }
        while self.world.is_readable(end) && !self.side(end).0.ended {
            self.read(end);
        }
        let (side, world) = self.side(end);
        if side.take(&world.rings[end], world) {
            assert!(side.ended, "attached before it is used");
            // The ATTACH arrived after the end, so it was not read.
            let _ = side.link.handle(NOW, Input::SegmentMissing);
            side.drain(world);
        }
    }

    pub(crate) fn release(&mut self, end: usize) {
        let (side, world) = self.side(end);
        side.release(&world.rings[end], world, 0);
    }

    pub(crate) fn harvest(&mut self, end: usize) {
        let (side, world) = self.side(end);
        side.harvest(&world.rings[1 - end], world);
    }

    /// Returns the reason why an end has ended.
    pub(crate) fn end_of(&self, end: usize) -> Option<End> {
        [&self.caller, &self.server][end].link.end()
    }
}
