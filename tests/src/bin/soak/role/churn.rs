//! `churn`: nodes that come, exchange a few messages, and go.

use std::time::{Duration, Instant};

use sm2_node::{Node, Publisher, Subscriber, diagnostics::LinkStatus};
use sm2_tests::random::Random;

use super::{
    subscriber::Numbers,
    work::{Work, connect, patient},
};
use crate::{message, tally::Tally};

/// How many nodes exist at a time.
const MEMBERS: usize = 4;
/// The longest life of a node.
const LIFE_MS: u64 = 300;
const BYTES: usize = 500;

pub(super) struct Churn {
    name: String,
    socket: String,
    members: Vec<Member>,
    /// How many nodes there were.
    count: u64,
    random: Random,
    resting: bool,
}

/// A node that publishes to all members, itself included, and subscribes to all.
struct Member {
    _node: Node,
    publisher: Publisher<[u8]>,
    subscriber: Subscriber<[u8]>,
    numbers: Numbers,
    instance: u64,
    number: u64,
    end: Instant,
}

impl Churn {
    pub(super) fn new(name: &str, socket: &str) -> Self {
        Self {
            name: name.to_owned(),
            socket: socket.to_owned(),
            members: Vec::new(),
            count: 0,
            random: Random::new(message::new_instance()),
            resting: false,
        }
    }

    fn join(&mut self) {
        self.count += 1;
        let name = format!("{}/{}", self.name, self.count);
        let life_ms = self.random.within(1..LIFE_MS);
        self.members.push(Member::new(&name, &self.socket, life_ms));
    }
}

impl Member {
    fn new(name: &str, socket: &str, life_ms: u64) -> Self {
        let node = connect(name, socket);
        Self {
            publisher: patient("publisher", || node.publisher("churn")),
            subscriber: patient("subscriber", || node.subscriber("churn")),
            _node: node,
            numbers: Numbers::default(),
            instance: message::new_instance(),
            number: 0,
            end: Instant::now() + Duration::from_millis(life_ms),
        }
    }

    fn turn(&mut self, tally: &mut Tally) {
        let mut bytes = [0; BYTES];
        message::fill(&mut bytes, self.instance, self.number + 1);
        if self.publisher.publish(&bytes).is_ok() {
            self.number += 1;
        }
        while let Ok(Some(sample)) = self.subscriber.try_recv() {
            self.numbers.check(&sample, tally);
        }
    }
}

impl Work for Churn {
    fn turn(&mut self, tally: &mut Tally) {
        if self.resting {
            self.members.clear();
        } else if self.members.len() < MEMBERS {
            self.join();
        }
        for member in &mut self.members {
            member.turn(tally);
        }
        let now = Instant::now();
        self.members.retain(|member| now < member.end);
        std::thread::sleep(Duration::from_millis(2));
    }

    fn set_resting(&mut self, resting: bool) {
        self.resting = resting;
    }

    fn is_settled(&mut self) -> bool {
        self.members.is_empty()
    }

    fn links(&self) -> Vec<LinkStatus> {
        let links = |it: &Member| [it.publisher.links(), it.subscriber.links()].concat();
        self.members.iter().flat_map(links).collect()
    }
}
