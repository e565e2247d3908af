//! A hundred robots whose networks are away for 72 hours in all, in virtual time.
//!
//! The network between a robot and the receiver delivers in order, after a delay. An outage loses some of the messages
//! on their way, delivers others whose acknowledgement is lost, and is noticed only later. The robots publish all the
//! time.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};
use std::time::Duration;

use sm2_bridge_core::{Duplicates, Fate, Id, Limits, Origin, Output, Spool};
use sm2_proto::{Instant, Name};

const ROBOTS: usize = 100;
const MINUTE: u64 = 60 * SECOND;
const SECOND: u64 = 1_000_000_000;
/// How long the robots publish.
const RUN: u64 = 150 * MINUTE;
/// The outages of one robot. One robot has a single long one instead.
const OUTAGES: usize = 3;
const OUTAGE: u64 = 15 * MINUTE;
const LONG_OUTAGE: u64 = 60 * MINUTE;
const DELAY: u64 = 200_000_000;
/// The longest time until a robot notices that its network is away.
const NOTICE_MAX: u64 = 10 * SECOND;
const RETRY: Duration = Duration::from_secs(15);
const LEN_MAX: u64 = 2_000;
/// Between two messages of a robot, on average.
const PERIOD: u64 = 4 * SECOND;
const RATE_BYTES_PER_S: u64 = 4_000;
const WINDOW_BYTES: u64 = 16_000;
/// A robot publishes some 250 bytes per second: this lasts for about half an hour.
const MAX_BYTES: u64 = 500_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    Publish,
    /// A message reaches the receiver, unless the network broke after the attempt and lost it.
    Arrive {
        id: Id,
        attempt: u32,
    },
    Acknowledge {
        id: Id,
        attempt: u32,
    },
    Break,
    /// The robot notices that its network is away.
    Notice,
    Heal,
    Poll,
}

struct Robot {
    spool: Spool,
    topic: Name,
    name: Name,
    is_up: bool,
    /// Counts the outages: what was sent before the last one may be lost.
    attempt: u32,
    /// The messages in the store of the robot: the number of each message, by its place in the spool.
    stored: BTreeMap<Id, u64>,
    published: u64,
    /// How often each message was taken by the receiver.
    taken: BTreeMap<u64, u32>,
    fates: BTreeMap<u64, Fate>,
    /// The time and length of each attempt to send.
    sends: Vec<(u64, u64)>,
    lens: BTreeMap<Id, u64>,
    next_poll: Option<u64>,
}

struct Fleet {
    robots: Vec<Robot>,
    /// By time; the number keeps events of the same moment in their order.
    events: BinaryHeap<Reverse<(u64, u64, usize, Event)>>,
    scheduled: u64,
    random: fastrand::Rng,
    receiver: Duplicates,
    duplicates: u64,
    /// Whether the robots notice outages; if not, only missing acknowledgements tell of them.
    is_noticed: bool,
    away: u64,
}

impl Fleet {
    fn new(is_noticed: bool) -> Self {
        let mut fleet = Self {
            robots: Vec::new(),
            events: BinaryHeap::new(),
            scheduled: 0,
            random: fastrand::Rng::with_seed(sm2_test_support::seed()),
            receiver: Duplicates::default(),
            duplicates: 0,
            is_noticed,
            away: 0,
        };
        for number in 0..ROBOTS {
            let mut limits = Limits::new(MAX_BYTES, WINDOW_BYTES).unwrap();
            limits = limits.with_rate(RATE_BYTES_PER_S).unwrap();
            limits = limits.with_retry(RETRY);
            fleet.robots.push(Robot {
                spool: Spool::new(limits),
                topic: Name::new("pose").unwrap(),
                name: Name::new(&format!("robot_{number}")).unwrap(),
                is_up: false,
                attempt: 0,
                stored: BTreeMap::new(),
                published: 0,
                taken: BTreeMap::new(),
                fates: BTreeMap::new(),
                sends: Vec::new(),
                lens: BTreeMap::new(),
                next_poll: None,
            });
            fleet.at(SECOND, number, Event::Heal);
            fleet.at(SECOND, number, Event::Publish);
            fleet.plan_outages(number);
        }
        fleet
    }

    fn plan_outages(&mut self, robot: usize) {
        let outages = match robot {
            0 => vec![LONG_OUTAGE],
            _ => vec![OUTAGE; OUTAGES],
        };
        // One in each part of the run, so that they do not overlap.
        let part = RUN / outages.len() as u64;
        for (number, outage) in outages.into_iter().enumerate() {
            let start =
                number as u64 * part + MINUTE + self.random.u64(0..part - outage - 2 * MINUTE);
            self.away += outage;
            self.at(start, robot, Event::Break);
            let notice = start + self.random.u64(0..NOTICE_MAX);
            if self.is_noticed {
                self.at(notice, robot, Event::Notice);
            }
            self.at(start + outage, robot, Event::Heal);
        }
    }

    fn at(&mut self, time: u64, robot: usize, event: Event) {
        self.scheduled += 1;
        self.events
            .push(Reverse((time, self.scheduled, robot, event)));
    }

    fn run(&mut self) {
        while let Some(Reverse((time, _, number, event))) = self.events.pop() {
            self.handle(time, number, event);
            self.drain(time, number);
            assert!(self.robots[number].spool.counts().is_balanced());
        }
    }

    fn handle(&mut self, time: u64, number: usize, event: Event) {
        let robot = &mut self.robots[number];
        match event {
            Event::Publish => {
                robot.published += 1;
                let len = self.random.u64(1..LEN_MAX);
                let id = robot.spool.offer(len, Instant(time));
                robot.stored.insert(id, robot.published);
                robot.lens.insert(id, len);
                if time < RUN {
                    let next = time + self.random.u64(1..2 * PERIOD);
                    self.at(next, number, Event::Publish);
                }
            }
            Event::Arrive { id, attempt } => self.arrive(time, number, id, attempt),
            Event::Acknowledge { id, attempt } => {
                if robot.is_up && robot.attempt == attempt {
                    robot.spool.acknowledge(id);
                }
            }
            Event::Break => {
                robot.is_up = false;
                robot.attempt += 1;
            }
            Event::Notice => robot.spool.disconnect(Instant(time)),
            Event::Heal => {
                robot.is_up = true;
                robot.spool.connect();
            }
            Event::Poll => robot.next_poll = None,
        }
    }

    fn arrive(&mut self, time: u64, number: usize, id: Id, attempt: u32) {
        let is_broken = self.robots[number].attempt != attempt;
        if is_broken && self.random.bool() {
            return;
        }
        let robot = &mut self.robots[number];
        // The number travels with the message: the store may have forgotten it.
        let origin = Origin {
            bridge: robot.name.clone(),
            epoch: 1,
            number: id.0 + 1,
        };
        if self.receiver.contains(&robot.topic, &origin) {
            self.duplicates += 1;
        } else {
            *robot.taken.entry(origin.number).or_default() += 1;
        }
        self.receiver.insert(&robot.topic, &origin);
        self.at(time + DELAY, number, Event::Acknowledge { id, attempt });
    }

    fn drain(&mut self, time: u64, number: usize) {
        while let Some(output) = self.robots[number].spool.poll(Instant(time)) {
            let robot = &mut self.robots[number];
            match output {
                Output::Send(id) => {
                    assert!(robot.stored.contains_key(&id), "the store has it no more");
                    robot.sends.push((time, robot.lens[&id]));
                    let attempt = robot.attempt;
                    // Between the break and its notice, messages go nowhere.
                    if robot.is_up {
                        self.at(time + DELAY, number, Event::Arrive { id, attempt });
                    }
                }
                Output::End(id, fate) => {
                    let published = robot.stored.remove(&id).expect("a second fate");
                    robot.fates.insert(published, fate);
                }
            }
        }
        let robot = &mut self.robots[number];
        let deadline = robot.spool.deadline().map(|it| it.0);
        if let Some(deadline) = deadline.filter(|it| robot.next_poll.is_none_or(|next| *it < next))
        {
            robot.next_poll = Some(deadline);
            self.at(deadline, number, Event::Poll);
        }
    }

    /// Each message that was handed over was taken once, and no other one more than once.
    fn judge(&self) {
        let mut expired = 0;
        for robot in &self.robots {
            let counts = robot.spool.counts();
            assert_eq!(counts.offered, robot.published);
            assert_eq!(
                (counts.spooled, counts.in_flight),
                (0, 0),
                "something is left"
            );
            for number in 1..=robot.published {
                let taken = robot.taken.get(&number).copied().unwrap_or_default();
                match robot.fates[&number] {
                    Fate::HandedOver => assert_eq!(taken, 1, "message {number} of {}", robot.name),
                    Fate::Expired => assert!(taken <= 1, "message {number} of {}", robot.name),
                    Fate::Refused => panic!("message {number} was refused"),
                }
            }
            expired += counts.expired;
            robot.judge_rate();
        }
        assert!(
            self.duplicates > 0,
            "no message came twice, so nothing was tried"
        );
        let long = self.robots[0].spool.counts().expired;
        assert!(long > 0, "the longest outage is longer than its spool");
        assert_eq!(long, expired, "the others have room");
    }
}

impl Robot {
    /// No flood after an outage.
    fn judge_rate(&self) {
        let mut first = 0;
        let mut sum = 0;
        for (time, len) in &self.sends {
            sum += len;
            while self.sends[first].0 + SECOND < *time {
                sum -= self.sends[first].1;
                first += 1;
            }
            assert!(
                sum <= WINDOW_BYTES + RATE_BYTES_PER_S,
                "{sum} bytes in a second"
            );
        }
    }
}

fn run(is_noticed: bool) {
    let mut fleet = Fleet::new(is_noticed);
    assert!(
        fleet.away >= 72 * 60 * MINUTE,
        "{} min",
        fleet.away / MINUTE
    );
    fleet.run();
    fleet.judge();
}

#[test]
fn a_fleet_loses_nothing_that_was_handed_over() {
    run(true);
}

#[test]
fn a_fleet_that_notices_no_outage_loses_nothing_that_was_handed_over() {
    run(false);
}
