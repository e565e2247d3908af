//! The network between the gateways: datagrams are lost, delayed, duplicated, and overtake each
//! other.

use std::{
    collections::{BTreeMap, BTreeSet},
    net::SocketAddr,
};

use sm2_proto::Instant;

use super::random::Random;

pub(crate) const MS: u64 = 1_000_000;
/// The longest queue of a slow link, as the time that it takes to send. Later datagrams are
/// dropped.
const QUEUE: u64 = 60 * MS;

/// How often the network loses and duplicates datagrams, and how slow it is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Conditions {
    pub(crate) lost_per_mille: u64,
    pub(crate) doubled_per_mille: u64,
    pub(crate) delay: (u64, u64),
    /// How long a link takes to send a datagram of any length.
    pub(crate) per_datagram: u64,
}

impl Conditions {
    /// Nothing is lost, and the delay is constant.
    pub(crate) const GOOD: Self = Self {
        lost_per_mille: 0,
        doubled_per_mille: 0,
        delay: (MS, MS),
        per_datagram: 0,
    };

    pub(crate) fn any(random: &mut Random) -> Self {
        let least = random.below(10) * MS;
        let rates = [0, 0, MS / 10, 2 * MS];
        Self {
            lost_per_mille: *random.one_of(&[0, 10, 50, 150]),
            doubled_per_mille: *random.one_of(&[0, 20, 100]),
            delay: (least, least + random.below(40) * MS),
            per_datagram: *random.one_of(&rates),
        }
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Datagram {
    pub(crate) from: usize,
    pub(crate) to: usize,
    pub(crate) bytes: Vec<u8>,
    pub(crate) is_beacon: bool,
}

pub(crate) struct Network {
    random: Random,
    pub(crate) conditions: Conditions,
    /// Pairs of gateways whose datagrams to each other are dropped.
    pub(crate) cut: BTreeSet<(usize, usize)>,
    under_way: BTreeMap<(Instant, u64), Datagram>,
    free_at: BTreeMap<(usize, usize), Instant>,
    count: u64,
}

impl Network {
    pub(crate) const fn new(random: Random, conditions: Conditions) -> Self {
        Self {
            random,
            conditions,
            cut: BTreeSet::new(),
            under_way: BTreeMap::new(),
            free_at: BTreeMap::new(),
            count: 0,
        }
    }

    pub(crate) fn send(&mut self, now: Instant, datagram: Datagram) {
        let (from, to) = (datagram.from, datagram.to);
        if self.cut.contains(&(from.min(to), from.max(to))) {
            return;
        }
        let Conditions {
            lost_per_mille,
            doubled_per_mille,
            delay: (least, most),
            per_datagram,
        } = self.conditions;
        if self.random.below(1_000) < lost_per_mille {
            return;
        }
        let free_at = self.free_at.entry((from, to)).or_insert(now);
        let start = (*free_at).max(now);
        if start.0 - now.0 > QUEUE {
            return;
        }
        *free_at = Instant(start.0 + per_datagram);
        let is_doubled = self.random.below(1_000) < doubled_per_mille;
        for _ in 0..=u8::from(is_doubled) {
            let late = least + self.random.below(most - least + 1);
            self.count += 1;
            let at = Instant(start.0 + per_datagram + late);
            self.under_way.insert((at, self.count), datagram.clone());
        }
    }

    pub(crate) fn next_at(&self) -> Option<Instant> {
        self.under_way.first_key_value().map(|((at, _), _)| *at)
    }

    pub(crate) fn arrived(&mut self, now: Instant) -> Option<Datagram> {
        let (at, count) = *self.under_way.first_key_value()?.0;
        (at <= now).then(|| self.under_way.remove(&(at, count)))?
    }
}

pub(crate) fn address(index: usize) -> SocketAddr {
    let last = u8::try_from(index).unwrap() + 1;
    SocketAddr::from(([10, 0, 0, last], 7633))
}

pub(crate) fn index(address: SocketAddr) -> usize {
    match address {
        SocketAddr::V4(it) => usize::from(it.ip().octets()[3]) - 1,
        SocketAddr::V6(_) => panic!("{address}: no such gateway"),
    }
}
