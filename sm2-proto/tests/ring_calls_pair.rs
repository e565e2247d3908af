//! Runs random operations on a caller and a server of the ring lane, also in the middle of each
//! other's operations. They are joined by two rings and by sockets that lose nothing. There is no
//! common order between sockets and rings.

// Shows CALL-RING, CALL-CANCEL, RNG-WAKE (proptest), bound: both ends, any operation in the middle of another.

use crate::ring_support::between::Between;
use crate::ring_support::calls::{CALLER, Calls, Outcome, SERVER};
use crate::support::cases;
use proptest::prelude::*;
use sm2_proto::{
    Farewell,
    link::{End, Input},
};

/// `within` is the segment of a message in a slot; `None` for a message in a cell.
#[derive(Clone, Copy, Debug)]
enum Op {
    Call {
        within: Option<u32>,
    },
    Reply {
        pick: usize,
        within: Option<u32>,
    },
    Read {
        end: usize,
    },
    Take {
        end: usize,
    },
    Release {
        end: usize,
        pick: usize,
    },
    Harvest {
        end: usize,
    },
    Cancel {
        pick: usize,
    },
    /// While the caller calls, before one of its accesses, the server reads, takes and replies.
    CallWhile {
        at: u32,
        steps: u8,
        within: Option<u32>,
    },
    /// While an end harvests, the other end takes and releases.
    HarvestWhile {
        end: usize,
        at: u32,
        steps: u8,
    },
    /// While the server takes, the caller calls and cancels.
    TakeWhile {
        at: u32,
        steps: u8,
        within: Option<u32>,
    },
    /// While the server replies, the caller takes, releases and cancels.
    ReplyWhile {
        at: u32,
        steps: u8,
        within: Option<u32>,
    },
    Retire {
        end: usize,
        segment: u32,
    },
    Full {
        end: usize,
        full: bool,
    },
    Park {
        end: usize,
    },
    Close {
        end: usize,
        eof: bool,
    },
}

fn op() -> impl Strategy<Value = Op> {
    let (end, segment, at, steps) = (0_usize..2, 0_u32..3, 0_u32..14, 1_u8..5);
    let within = prop_oneof![Just(None), segment.clone().prop_map(Some)];
    let pick = 0_usize..4;
    prop_oneof![
        60 => within.clone().prop_map(|within| Op::Call { within }),
        50 => (pick.clone(), within.clone()).prop_map(|(pick, within)| Op::Reply { pick, within }),
        60 => end.clone().prop_map(|end| Op::Read { end }),
        90 => end.clone().prop_map(|end| Op::Take { end }),
        60 => (end.clone(), pick.clone()).prop_map(|(end, pick)| Op::Release { end, pick }),
        20 => end.clone().prop_map(|end| Op::Harvest { end }),
        40 => pick.prop_map(|pick| Op::Cancel { pick }),
        15 => (at.clone(), steps.clone(), within.clone())
            .prop_map(|(at, steps, within)| Op::CallWhile { at, steps, within }),
        15 => (at.clone(), steps.clone(), within.clone())
            .prop_map(|(at, steps, within)| Op::TakeWhile { at, steps, within }),
        15 => (end.clone(), at.clone(), steps.clone())
            .prop_map(|(end, at, steps)| Op::HarvestWhile { end, at, steps }),
        15 => (at, steps, within)
            .prop_map(|(at, steps, within)| Op::ReplyWhile { at, steps, within }),
        8 => (end.clone(), segment).prop_map(|(end, segment)| Op::Retire { end, segment }),
        12 => (end.clone(), any::<bool>()).prop_map(|(end, full)| Op::Full { end, full }),
        20 => end.clone().prop_map(|end| Op::Park { end }),
        1 => (end, any::<bool>()).prop_map(|(end, eof)| Op::Close { end, eof }),
    ]
}

struct Run {
    pair: Calls,
    /// True if no end has closed.
    sound: bool,
}

impl Run {
    fn step(&mut self, op: Op) {
        let Calls {
            world,
            caller,
            server,
        } = &mut self.pair;
        let (requests, replies) = (&world.rings[SERVER], &world.rings[CALLER]);
        match op {
            Op::Call { within } => caller.call(requests, world, within),
            Op::Reply { pick, within } => server.reply(replies, world, pick, within),
            Op::Read { end } => self.pair.read(end),
            Op::Take { end } => self.pair.take(end),
            Op::Release { end, pick } => {
                let (side, world) = self.pair.side(end);
                side.release(&world.rings[end], world, pick);
            }
            Op::Harvest { end } => self.pair.harvest(end),
            Op::Cancel { pick } => caller.cancel(world, pick),
            Op::CallWhile { at, steps, within } => self.call_while(at, steps, within),
            Op::TakeWhile { at, steps, within } => self.take_while(at, steps, within),
            Op::HarvestWhile { end, at, steps } => self.harvest_while(end, at, steps),
            Op::ReplyWhile { at, steps, within } => self.reply_while(at, steps, within),
            Op::Retire { end, segment } => {
                let (side, world) = self.pair.side(end);
                side.retire(world, segment);
            }
            Op::Full { end, full } => {
                let (side, world) = self.pair.side(end);
                side.set_full(world, full);
            }
            Op::Park { end } => self.park(end),
            Op::Close { end, eof } => {
                self.sound = false;
                let close = Input::Close(Farewell::Done.code());
                let (side, world) = self.pair.side(end);
                side.close(world, if eof { Input::Eof } else { close });
            }
        }
    }

    /// The caller makes a call, and the server works in the middle of it.
    fn call_while(&mut self, at: u32, steps: u8, within: Option<u32>) {
        let Calls {
            world,
            caller,
            server,
        } = &mut self.pair;
        let (requests, replies) = (&world.rings[SERVER], &world.rings[CALLER]);
        let between = Between::new(requests, at, |words| {
            for _ in 0..steps {
                server.read(world, false);
                server.take(words, world);
                server.reply(replies, world, 0, within);
                server.release(words, world, 0);
            }
            false
        });
        caller.call(&between, world, within);
    }

    /// The server takes a request, and the caller works in the middle of it.
    fn take_while(&mut self, at: u32, steps: u8, within: Option<u32>) {
        let Calls {
            world,
            caller,
            server,
        } = &mut self.pair;
        let requests = &world.rings[SERVER];
        let between = Between::new(requests, at, |words| {
            for pick in 0..steps {
                caller.call(words, world, within);
                caller.cancel(world, pick.into());
            }
            false
        });
        server.take(&between, world);
    }

    /// One end harvests, and the other end works in the middle of it.
    fn harvest_while(&mut self, end: usize, at: u32, steps: u8) {
        let Calls {
            world,
            caller,
            server,
        } = &mut self.pair;
        let (this, other) = match end {
            CALLER => (caller, server),
            _ => (server, caller),
        };
        let between = Between::new(&world.rings[1 - end], at, |words| {
            for _ in 0..steps {
                other.take(words, world);
                other.release(words, world, 0);
            }
            false
        });
        this.harvest(&between, world);
    }

    /// The server replies, and the caller works in the middle of it.
    fn reply_while(&mut self, at: u32, steps: u8, within: Option<u32>) {
        let Calls {
            world,
            caller,
            server,
        } = &mut self.pair;
        let replies = &world.rings[CALLER];
        let between = Between::new(replies, at, |words| {
            for pick in 0..steps {
                caller.take(words, world);
                caller.release(words, world, 0);
                caller.cancel(world, pick.into());
            }
            false
        });
        server.reply(&between, world, 0, within);
    }

    /// Puts an end to sleep if it has nothing to do.
    fn park(&mut self, end: usize) {
        let (side, world) = self.pair.side(end);
        side.link.park(&world.rings[end]);
        side.harvest(&world.rings[1 - end], world);
        side.asleep = !side.has_work(world);
    }

    fn check(&self) {
        let Calls {
            world,
            caller,
            server,
        } = &self.pair;
        for side in [caller, server] {
            assert!(
                !matches!(side.link.end(), Some(End::Violation(_))),
                "honest"
            );
            assert_eq!(side.ended, side.link.end().is_some());
            for delivery in &side.held {
                side.check_content(world, delivery);
            }
        }
        let is_served = |id| server.taken.contains(&id);
        let depth = |ring: usize| usize::from(world.rings[ring].layout.depth());
        caller.check_in_flight(depth(SERVER), is_served);
        let is_replied = |id| matches!(caller.calls[&id], Some(Outcome::Reply(_)));
        server.check_in_flight(depth(CALLER), is_replied);
        let open = caller.calls.values().filter(|it| it.is_none()).count();
        assert_eq!(caller.link.calls(), open);
        assert!(server.taken.iter().all(|id| caller.calls.contains_key(id)));
        for (end, side) in [(CALLER, caller), (SERVER, server)] {
            let wakes = world.is_readable(end) || !self.sound;
            assert!(
                !side.asleep || wakes || !side.has_work(world),
                "{end} sleeps on"
            );
        }
    }

    /// Lets both ends finish all work: the sockets are open, and the applications take everything.
    fn run_until_quiet(&mut self) {
        loop {
            let before = self.state();
            for end in [CALLER, SERVER] {
                let (side, world) = self.pair.side(end);
                side.set_full(world, false);
                self.pair.read(end);
                self.pair.take(end);
                self.pair.harvest(end);
                let (side, world) = self.pair.side(end);
                for within in 0..3 {
                    side.reply(&world.rings[CALLER], world, 0, Some(within));
                }
                side.release(&world.rings[end], world, 0);
                self.check();
            }
            if self.state() == before {
                return;
            }
        }
    }

    fn state(&self) -> (sm2_proto::link::Link, sm2_proto::link::Link, [usize; 2]) {
        let Calls {
            world,
            caller,
            server,
        } = &self.pair;
        let wires = world.wires.borrow();
        let wires = [wires[0].len(), wires[1].len()];
        (caller.link.clone(), server.link.clone(), wires)
    }

    /// CALL-RING: each call has one reply or one failure. If the link has not ended, each call has
    /// one reply.
    fn check_settled(&self) {
        let caller = &self.pair.caller;
        for (call, outcome) in &caller.calls {
            let is_fine = match outcome {
                Some(Outcome::Reply(_)) => true,
                Some(Outcome::Failed) => !self.sound,
                None => false,
            };
            assert!(is_fine, "call {call}: {outcome:?}");
        }
        if self.sound {
            let in_flight = caller.link.in_flight() + self.pair.server.link.in_flight();
            assert_eq!(in_flight, 0);
            assert!(self.pair.caller.calls.keys().eq(&self.pair.server.taken));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(600).cases, ..ProptestConfig::default() })]

    /// Checks CALL-RING and CALL-CANCEL.
    //= SM2-RNG-002, SM2-RNG-008, SM2-RNG-012, SM2-RNG-009, SM2-RNG-010, SM2-RNG-011 test
    //= SM2-RNG-013, SM2-SRV-002, SM2-SRV-004, SM2-OPN-010 test
    #[test]
    fn ring_calls_pair(
        depth in [1_u16..4, 1..4],
        max_borrowed in [1_u16..4, 1..4],
        ops in prop::collection::vec(op(), 0..300),
    ) {
        let mut run = Run { pair: Calls::fresh(depth, max_borrowed), sound: true };
        for op in ops {
            run.step(op);
            run.check();
        }
        run.run_until_quiet();
        run.check_settled();
        if run.sound {
            run.step(Op::Close { end: SERVER, eof: false });
            run.run_until_quiet();
            run.check_settled();
        }
    }
}
