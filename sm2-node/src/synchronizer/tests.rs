//! The decisions of synchronizers, compared with searches that look at everything.

use std::collections::VecDeque;

use proptest::prelude::*;
use sm2_proto::Instant;

use super::approximate::Options;
use super::core::Core;
use super::queues::{InputCounters, Output};

/// The times of the messages of each input.
type Times = Vec<Vec<u64>>;
/// The times of a set.
type Set = Vec<u64>;

/// Later than all other times, for messages that complete everything before them.
const FAR: u64 = 1 << 40;

/// A core, and the messages that its owner would hold.
struct Owner {
    core: Core,
    held: Vec<VecDeque<u64>>,
    queue_max: usize,
    sets: Vec<Set>,
}

impl Owner {
    fn new(core: Core, inputs: usize, queue_max: usize) -> Self {
        Self {
            core,
            held: vec![VecDeque::new(); inputs],
            queue_max,
            sets: Vec::new(),
        }
    }

    fn approximate(options: Options, queue_max: usize) -> Self {
        let inputs = options.min_periods_ns.len();
        Self::new(Core::approximate(options, queue_max), inputs, queue_max)
    }

    fn exact(inputs: usize, queue_max: usize) -> Self {
        Self::new(Core::exact(inputs, queue_max), inputs, queue_max)
    }

    fn push(&mut self, input: usize, time: u64) {
        self.held[input].push_back(time);
        assert!(self.held[input].len() <= self.queue_max + 1);
        self.core.handle(input, Instant(time));
        while let Some(output) = self.core.poll() {
            match output {
                Output::DropOldest(input) => assert!(self.held[input].pop_front().is_some()),
                Output::DropNewest(input) => assert!(self.held[input].pop_back().is_some()),
                Output::Set => {
                    let set = self.held.iter_mut().map(|it| it.pop_front().unwrap());
                    self.sets.push(set.collect());
                }
            }
        }
        self.check();
    }

    /// The accounts are right, and the queues are as long as they may be.
    fn check(&self) {
        for (input, held) in self.held.iter().enumerate() {
            let counters = self.core.counters(input);
            let InputCounters {
                received,
                used,
                unmatched,
                overflow,
                out_of_order,
                ..
            } = counters;
            assert!(held.len() <= self.queue_max);
            assert_eq!(counters.held, held.len() as u64);
            let sum = counters.held + used + unmatched + overflow + out_of_order;
            assert_eq!(received, sum, "{counters:?}");
            assert_eq!(used, self.sets.len() as u64);
        }
        assert_eq!(self.core.sets(), self.sets.len() as u64);
    }

    /// Pushes all messages: always the next one of the input that the order names, or of the next input that has one.
    fn push_all(&mut self, times: &Times, order: &[usize]) {
        let mut left: Vec<VecDeque<u64>> = times.iter().map(|it| it.clone().into()).collect();
        let mut order = order.iter().cycle();
        while left.iter().any(|it| !it.is_empty()) {
            let start = *order.next().unwrap();
            let count = left.len();
            let inputs = (0..count).map(|it| (start + it) % count);
            for input in inputs {
                if let Some(time) = left[input].pop_front() {
                    self.push(input, time);
                    break;
                }
            }
        }
    }

    /// Messages that come much later, so nothing is left to wait for.
    fn complete(&mut self) {
        for input in 0..self.held.len() {
            self.push(input, FAR * (input as u64 + 1));
        }
        self.sets.retain(|set| set.iter().all(|&time| time < FAR));
    }
}

const fn options(percent: u32, max_interval_ns: u64, min_periods_ns: Vec<u64>) -> Options {
    Options {
        max_interval_ns,
        age_penalty_percent: percent,
        min_periods_ns,
    }
}

/// The sets of an unlimited approximate synchronizer, by the definition: of all messages, each set is the best one that
/// contains the pivot, and everything up to it is used up.
fn all_approximate(times: &Times, percent: u32, max_interval: u64) -> Vec<Set> {
    let mut from = vec![0; times.len()];
    let mut sets = Vec::new();
    loop {
        let heads = times.iter().zip(&from).map(|(it, &at)| it.get(at).copied());
        let Some(heads) = heads.collect::<Option<Set>>() else {
            return sets;
        };
        let (start, pivot) = ends(&heads);
        if pivot - start > max_interval {
            let first = heads.iter().position(|&it| it == start).unwrap();
            from[first] += 1;
            continue;
        }
        // One possible set for each message that may be the earliest.
        let mut starts: Set = times.concat();
        starts.retain(|it| (start..=pivot).contains(it));
        starts.sort_unstable();
        let mut best: Option<Set> = None;
        for start in starts {
            let set = times.iter().zip(&from).map(|(times, &from)| {
                let mut times = times[from..].iter().copied();
                times.find(|&it| it >= start)
            });
            let Some(set) = set.collect::<Option<Set>>() else {
                break;
            };
            let is_better = best.as_ref().is_none_or(|best| {
                let (grown, saved) = (ends(&set).1 - ends(best).1, ends(&set).0 - ends(best).0);
                grown * (100 + u64::from(percent)) < saved * 100
            });
            if is_better {
                best = Some(set);
            }
        }
        let best = best.unwrap();
        for (input, time) in best.iter().enumerate() {
            while times[input][from[input]] < *time {
                from[input] += 1;
            }
            from[input] += 1;
        }
        sets.push(best);
    }
}

/// The earliest and the latest time of a set.
fn ends(set: &[u64]) -> (u64, u64) {
    (*set.iter().min().unwrap(), *set.iter().max().unwrap())
}

/// The sets of an unlimited exact synchronizer: each time as often as the input with the fewest messages has it.
fn all_exact(times: &Times) -> Vec<Set> {
    let count = |of: &[u64], time| of.iter().filter(|&&it| it == time).count();
    let mut distinct = times.concat();
    distinct.sort_unstable();
    distinct.dedup();
    let sets = distinct.into_iter().flat_map(|time| {
        let least = times.iter().map(|it| count(it, time)).min().unwrap();
        std::iter::repeat_n(vec![time; times.len()], least)
    });
    sets.collect()
}

/// Sorted times of two to four inputs with different periods.
fn times() -> impl Strategy<Value = Times> {
    let input = (1_u64..40).prop_flat_map(|most| {
        proptest::collection::vec(0..=most, 0..30).prop_map(|steps| {
            let sums = steps.iter().scan(0, |time, step| {
                *time += step;
                Some(*time)
            });
            sums.collect::<Vec<_>>()
        })
    });
    proptest::collection::vec(input, 2..=4)
}

fn order() -> impl Strategy<Value = Vec<usize>> {
    proptest::collection::vec(0_usize..4, 1..20)
}

fn interval() -> impl Strategy<Value = u64> {
    prop_oneof![Just(u64::MAX), 0_u64..60]
}

proptest! {
    /// In each order of arrival, the sets are those of the definition, and nothing but arrival delays them.
    #[test]
    fn approximate_sets_are_the_best_ones(
        times in times(), order in order(), percent in 0_u32..30, max_interval in interval(),
    ) {
        let wanted = all_approximate(&times, percent, max_interval);
        let options = options(percent, max_interval, vec![0; times.len()]);
        let mut owner = Owner::approximate(options, 1_000);
        owner.push_all(&times, &order);
        prop_assert!(wanted.starts_with(&owner.sets), "{:?} of {:?}", owner.sets, wanted);
        owner.complete();
        prop_assert_eq!(owner.sets, wanted);
    }

    /// With a true lower bound of the periods, the same sets come earlier, or at the same time.
    #[test]
    fn a_known_period_only_makes_sets_earlier(times in times(), order in order(), percent in 0_u32..30) {
        let periods = times.iter().map(|it| {
            it.windows(2).map(|it| it[1] - it[0]).min().unwrap_or(0)
        });
        let without = options(percent, u64::MAX, vec![0; times.len()]);
        let with = options(percent, u64::MAX, periods.collect());
        let (mut without, mut with) =
            (Owner::approximate(without, 1_000), Owner::approximate(with, 1_000));
        without.push_all(&times, &order);
        with.push_all(&times, &order);
        prop_assert!(with.sets.starts_with(&without.sets));
        with.complete();
        without.complete();
        prop_assert_eq!(with.sets, without.sets);
    }

    /// Without a penalty, no set of the messages that are left is shorter and contains the pivot.
    #[test]
    fn no_set_with_the_pivot_is_shorter(times in times(), order in order()) {
        let mut owner = Owner::approximate(options(0, u64::MAX, vec![0; times.len()]), 1_000);
        owner.push_all(&times, &order);
        let mut left: Vec<VecDeque<u64>> = times.iter().map(|it| it.clone().into()).collect();
        for set in &owner.sets {
            let pivot = left.iter().map(|it| it[0]).max().unwrap();
            let (start, end) = ends(set);
            prop_assert!(start <= pivot && pivot <= end);
            for start in left.iter().flatten().copied().filter(|&it| it <= pivot) {
                // The shortest set that begins here: the next message of each input.
                let nexts = left.iter().map(|it| it.iter().copied().find(|&it| it >= start));
                if let Some(nexts) = nexts.collect::<Option<Set>>() {
                    let (first, last) = ends(&nexts);
                    prop_assert!(end - ends(set).0 <= last - first);
                }
            }
            for (left, time) in left.iter_mut().zip(set) {
                while left.front().is_some_and(|it| it < time) {
                    left.pop_front();
                }
                left.pop_front();
            }
        }
    }

    /// Short queues and times in disorder: the accounts hold, and sets do not cross.
    #[test]
    fn short_queues_keep_the_promises(
        times in proptest::collection::vec(proptest::collection::vec(0_u64..200, 0..60), 2..=4),
        order in order(), queue_max in 1_usize..6, percent in 0_u32..30, max_interval in interval(),
        exact: bool,
    ) {
        let options = options(percent, max_interval, vec![3; times.len()]);
        let mut owner = match exact {
            true => Owner::exact(times.len(), queue_max),
            false => Owner::approximate(options, queue_max),
        };
        owner.push_all(&times, &order);
        for set in &owner.sets {
            let (start, end) = ends(set);
            let longest = if exact { 0 } else { max_interval };
            prop_assert!(end - start <= longest);
        }
        for pair in owner.sets.windows(2) {
            prop_assert!(pair[0].iter().zip(&pair[1]).all(|(before, after)| before <= after));
        }
    }

    #[test]
    fn exact_sets_are_all_equal_times(times in times(), order in order()) {
        let mut owner = Owner::exact(times.len(), 1_000);
        owner.push_all(&times, &order);
        prop_assert_eq!(&owner.sets, &all_exact(&times));
        // Nothing waits that another input has gone past.
        let newest = (0..times.len()).filter_map(|it| owner.core.newest(it)).max();
        for held in owner.held.iter().flatten() {
            prop_assert!(newest.is_none_or(|newest| *held <= newest.0));
        }
    }
}

/// The image after a scan ends the search: each later set would have to contain the scan as well.
#[test]
fn a_camera_and_a_lidar() {
    let mut owner = Owner::approximate(options(10, u64::MAX, vec![0, 0]), 8);
    for (input, time) in [(0, 0), (0, 33), (1, 60)] {
        owner.push(input, time);
        assert_eq!(owner.sets, [] as [Set; 0], "at {time}");
    }
    owner.push(0, 66);
    assert_eq!(owner.sets, [[66, 60]]);
    assert_eq!(owner.core.counters(0).unmatched, 2);
}

/// An image that comes at least 20 later than the one before cannot make a better set.
#[test]
fn a_known_period_completes_a_set_at_once() {
    let mut owner = Owner::approximate(options(10, u64::MAX, vec![20, 0]), 8);
    owner.push(0, 58);
    owner.push(1, 60);
    assert_eq!(owner.sets, [[58, 60]]);
    owner.push(0, 70);
    assert_eq!(owner.core.counters(0).too_soon, 1);
}

/// The earliest next message of the first input alone decides nothing: the set with it is neither better nor the end of
/// the search. That of the second one decides.
#[test]
fn known_periods_complete_a_set_before_messages_that_are_held() {
    let mut owner = Owner::approximate(options(0, u64::MAX, vec![12, 100, 0]), 8);
    for (input, time) in [(0, 0), (1, 1)] {
        owner.push(input, time);
        assert_eq!(owner.sets, [] as [Set; 0], "at {time}");
    }
    owner.push(2, 10);
    assert_eq!(owner.sets, [[0, 1, 10]]);
}

#[test]
fn an_input_that_is_ahead_drops_its_oldest_messages() {
    let mut owner = Owner::approximate(options(10, u64::MAX, vec![0, 0]), 2);
    for time in [10, 20, 30] {
        owner.push(0, time);
    }
    assert_eq!(owner.core.counters(0).overflow, 1);
    // The message of 10 is gone, which might have been better for this one.
    owner.push(1, 11);
    owner.push(1, 21);
    owner.push(1, 31);
    owner.push(0, 40);
    assert_eq!(owner.sets, [[20, 21], [30, 31]]);
}

#[test]
fn a_message_out_of_order_is_dropped_until_the_queues_are_cleared() {
    let mut owner = Owner::exact(2, 4);
    owner.push(0, 50);
    owner.push(0, 40);
    assert_eq!(owner.core.counters(0).out_of_order, 1);
    owner.core.clear();
    owner.held[0].clear();
    while owner.core.poll().is_some() {}
    owner.push(0, 40);
    owner.push(1, 40);
    assert_eq!(owner.sets, [[40, 40]]);
}
