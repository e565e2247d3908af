//! Random kills, stops and take-overs.

use std::time::{Duration, Instant};

use sm2_tests::random::Random;

use crate::{child::Child, fleet::Fleet, managers::Managers, report::Report};

/// The pauses between two disturbances, in milliseconds.
const PAUSES_MS: [u64; 4] = [5, 50, 150, 400];
/// The lengths of stops: less than 5 s, after which a Manager gives up the links of a stopped node.
const STOPS_MS: [u64; 4] = [1, 20, 200, 1_500];

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
    pub(crate) fn act(&mut self, managers: &mut Managers, fleet: &mut Fleet, report: &mut Report) {
        if Instant::now() < self.due {
            return;
        }
        let pause = self.random.choose(&PAUSES_MS);
        self.due = Instant::now() + Duration::from_millis(self.random.within(1..pause + 1));
        match self.random.within(0..100) {
            0..50 => {
                let index = self.random.within(0..fleet.victims.len() as u64);
                fleet.kill(index as usize, report);
            }
            50..60 if managers.are_settled() => match self.random.within(0..4) {
                0 | 1 => managers.kill_active(report),
                2 => managers.kill_standby(report),
                _ => managers.hand_over(),
            },
            50..65 => {
                let both = [&mut managers.active, &mut managers.standby];
                let index = self.random.within(0..2);
                self.stop(both[index as usize], report);
            }
            65..82 => {
                let index = self.random.within(0..fleet.witnesses.len() as u64);
                self.stop(&mut fleet.witnesses[index as usize].child, report);
            }
            _ => {
                let index = self.random.within(0..fleet.victims.len() as u64);
                self.stop(&mut fleet.victims[index as usize], report);
            }
        }
    }

    fn stop(&mut self, child: &mut Child, report: &mut Report) {
        if !child.is_stopped() {
            report.stops += 1;
            let most = self.random.choose(&STOPS_MS);
            child.stop(Duration::from_millis(self.random.within(0..most + 1)));
        }
    }
}
