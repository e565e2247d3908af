//! Random kills, stops, shortages and take-overs.

use std::time::{Duration, Instant};

use sm2_tests::random::Random;

use crate::{child::Child, report::Report, shortage::Kind, world::World};

/// The pauses between two disturbances, in milliseconds.
const PAUSES_MS: [u64; 4] = [5, 50, 150, 400];
/// The lengths of stops and shortages: less than 5 s, after which a Manager gives up the links of a stopped
/// node.
const LENGTHS_MS: [u64; 4] = [1, 20, 200, 1_500];

/// The moment of the next disturbance.
pub(crate) struct Disturbance {
    random: Random,
    due: Instant,
}

impl Disturbance {
    pub(crate) fn new(random: Random) -> Self {
        Self {
            random,
            due: Instant::now(),
        }
    }

    /// Disturbs one process, if it is time.
    pub(crate) fn act(&mut self, world: &mut World, report: &mut Report) {
        if Instant::now() < self.due {
            return;
        }
        let pause = self.random.choose(&PAUSES_MS);
        self.due = Instant::now() + Duration::from_millis(self.random.within(1..pause + 1));
        match self.random.within(0..100) {
            0..47 => {
                let index = self.index(world.fleet.victims.len());
                world.fleet.kill(index, report);
            }
            47..57 => self.change_manager(world, report),
            57..58 => {
                let index = world.mortal_gateway();
                world.gateways.kill(index, report);
            }
            58..95 => {
                let child = self.any(world);
                self.stop(child, report);
            }
            _ => {
                let child = self.any(world);
                self.shorten(child, report);
            }
        }
    }

    fn change_manager(&mut self, world: &mut World, report: &mut Report) {
        // The near domain has more of them to lose.
        let managers = &mut world.managers[usize::from(self.random.within(0..4) == 0)];
        if managers.are_settled() {
            match self.random.within(0..4) {
                0 | 1 => managers.kill_active(report),
                2 => managers.kill_standby(report),
                _ => managers.hand_over(),
            }
        }
    }

    /// Any process: each group of processes is as likely as its share says.
    fn any<'a>(&mut self, world: &'a mut World) -> &'a mut Child {
        match self.random.within(0..100) {
            0..15 => {
                let managers = &mut world.managers[self.index(2)];
                match self.index(2) {
                    0 => &mut managers.active,
                    _ => &mut managers.standby,
                }
            }
            15..25 => &mut world.gateways.both[self.index(2)].child,
            25..65 => {
                let index = self.index(world.fleet.witnesses.len());
                &mut world.fleet.witnesses[index].child
            }
            _ => {
                let index = self.index(world.fleet.victims.len());
                &mut world.fleet.victims[index]
            }
        }
    }

    fn index(&mut self, len: usize) -> usize {
        self.random.within(0..len as u64) as usize
    }

    fn stop(&mut self, child: &mut Child, report: &mut Report) {
        if !child.is_stopped() {
            report.stops += 1;
            child.stop(self.length());
        }
    }

    fn shorten(&mut self, child: &mut Child, report: &mut Report) {
        let kind = match child.can_lack_addresses() && self.random.within(0..2) == 0 {
            true => Kind::Addresses,
            false => Kind::Descriptors,
        };
        let length = self.length();
        if child.shorten(kind, length, &mut self.random) {
            report.faults += 1;
        }
    }

    /// The length of a stop or a shortage.
    fn length(&mut self) -> Duration {
        let most = self.random.choose(&LENGTHS_MS);
        Duration::from_millis(self.random.within(0..most + 1))
    }
}
