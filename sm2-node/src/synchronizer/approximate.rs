//! Sets of messages with similar times: the algorithm `ApproximateTime` of ROS 2's `message_filters`.
//!
//! An *interval* is the time from the earliest to the latest message of a set. While each input holds a message, the
//! latest of the oldest messages is the *pivot*: every later set needs a message of the pivot's input, and no message
//! of that input is older. The search looks at all sets that contain the pivot, from the earliest to the latest: it
//! moves on by replacing the earliest message of the set by the next one of the same input, so it keeps the times of
//! the others as near as possible. It keeps the best set so far, the *candidate*, and ends when no later set can be
//! better.
//!
//! A later set is better if its interval is shorter by more than the *age penalty*: with `grown`, how much later its
//! end is, and `saved`, how much later its start is, it is better if `grown * (1 + penalty) < saved`.

use super::queues::{Queues, Unused};

/// Options of the search.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Options {
    /// The longest interval of a set, in nanoseconds.
    pub(super) max_interval_ns: u64,
    /// The penalty for a later set, in percent.
    pub(super) age_penalty_percent: u32,
    /// A lower bound of the time between two messages of each input, in nanoseconds.
    pub(super) min_periods_ns: Vec<u64>,
}

/// The search for the next set.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Search {
    options: Options,
    /// How many of the held messages of each input the search has moved past. With a candidate, the oldest message of
    /// each input belongs to it.
    passed: Vec<usize>,
    /// Whether an input has dropped messages that might have been a better choice, so it must not have the pivot.
    has_dropped: Vec<bool>,
    candidate: Option<Candidate>,
    /// Buffer of [`is_best_for_sure`](Self::is_best_for_sure).
    supposed: Vec<usize>,
}

/// The best set so far. Times are in nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Candidate {
    start: u64,
    end: u64,
    pivot: usize,
    pivot_time: u64,
}

/// The first message of a set and the last one, with their inputs. Times are in nanoseconds.
struct Ends {
    first: usize,
    start: u64,
    last: usize,
    end: u64,
}

impl Search {
    pub(super) fn new(options: Options) -> Self {
        let inputs = options.min_periods_ns.len();
        Self {
            options,
            passed: vec![0; inputs],
            has_dropped: vec![false; inputs],
            candidate: None,
            supposed: Vec::new(),
        }
    }

    pub(super) fn min_period_ns(&self, input: usize) -> u64 {
        self.options.min_periods_ns[input]
    }

    /// Gives up the search.
    pub(super) fn restart(&mut self) {
        self.passed.fill(0);
        self.candidate = None;
    }

    /// As [`restart`](Self::restart), because an input held too many messages. The caller drops the oldest one.
    pub(super) fn overflow(&mut self, input: usize) {
        self.restart();
        self.has_dropped[input] = true;
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        self.restart();
        self.has_dropped.fill(false);
    }

    /// Searches while each input has a message that the search has not moved past.
    pub(super) fn process(&mut self, queues: &mut Queues) {
        while let Some(ends) = self.ends(queues) {
            for input in 0..queues.inputs() {
                // No message that was dropped would have been a better choice than the present one.
                self.has_dropped[input] &= input == ends.last;
            }
            let candidate = match self.candidate {
                None if self.is_no_candidate(&ends) => {
                    queues.drop_oldest(ends.first, Unused::Unmatched);
                    continue;
                }
                None => self.choose(&ends, (ends.last, ends.end), queues),
                Some(best) if self.is_better(&ends, best) => {
                    self.choose(&ends, (best.pivot, best.pivot_time), queues)
                }
                Some(best) => best,
            };
            self.passed[ends.first] += 1;
            let is_over = ends.first == candidate.pivot
                || self.reaches(ends.end, candidate)
                || (self.ends(queues).is_none() && self.is_best_for_sure(candidate, queues));
            if is_over {
                self.restart();
                queues.take_set();
            }
        }
    }

    /// The ends of the next set; `None` if an input has no further message.
    fn ends(&self, queues: &Queues) -> Option<Ends> {
        let time = |input| queues.time(input, self.passed[input]).map(|time| time.0);
        ends_of((0..queues.inputs()).map(time))
    }

    fn is_no_candidate(&self, ends: &Ends) -> bool {
        ends.end - ends.start > self.options.max_interval_ns || self.has_dropped[ends.last]
    }

    fn is_better(&self, ends: &Ends, best: Candidate) -> bool {
        self.penalized(ends.end - best.end) < 100 * u128::from(ends.start - best.start)
    }

    /// Whether no set that ends at `end` or later is better than the candidate: each contains the pivot.
    fn reaches(&self, end: u64, best: Candidate) -> bool {
        self.penalized(end - best.end) >= 100 * u128::from(best.pivot_time - best.start)
    }

    /// A time with the penalty, in hundredths of a nanosecond.
    fn penalized(&self, ns: u64) -> u128 {
        u128::from(ns) * (100 + u128::from(self.options.age_penalty_percent))
    }

    /// Makes the next set the candidate. The messages before it are not needed any more.
    fn choose(
        &mut self,
        ends: &Ends,
        (pivot, pivot_time): (usize, u64),
        queues: &mut Queues,
    ) -> Candidate {
        for (input, passed) in self.passed.iter_mut().enumerate() {
            for _ in 0..std::mem::take(passed) {
                queues.drop_oldest(input, Unused::Unmatched);
            }
        }
        let candidate = Candidate {
            start: ends.start,
            end: ends.end,
            pivot,
            pivot_time,
        };
        self.candidate = Some(candidate);
        candidate
    }

    /// Whether no message that is still to come can make a better set. Supposes the best time for each of them: that of
    /// the pivot, which every set contains anyway, or the earliest that its input permits, if that is later.
    fn is_best_for_sure(&mut self, candidate: Candidate, queues: &Queues) -> bool {
        let mut supposed = std::mem::take(&mut self.supposed);
        supposed.clone_from(&self.passed);
        let is_best = loop {
            let time = |input: usize| {
                let held = queues.time(input, supposed[input]).map(|time| time.0);
                held.or_else(|| {
                    let newest = queues.newest(input)?.0;
                    let next = newest.saturating_add(self.min_period_ns(input));
                    Some(next.max(candidate.pivot_time))
                })
            };
            let Some(ends) = ends_of((0..queues.inputs()).map(time)) else {
                break false;
            };
            if self.reaches(ends.end, candidate) {
                break true;
            }
            // The supposed messages are not before the pivot, so only messages that are held are passed below.
            if self.is_better(&ends, candidate) || ends.start >= candidate.pivot_time {
                break false;
            }
            supposed[ends.first] += 1;
        };
        self.supposed = supposed;
        is_best
    }
}

/// The ends of a set, by the times of its messages. Among equal times, the first input counts.
fn ends_of(times: impl Iterator<Item = Option<u64>>) -> Option<Ends> {
    let mut ends: Option<Ends> = None;
    for (input, time) in times.enumerate() {
        let time = time?;
        let ends = ends.get_or_insert(Ends {
            first: input,
            start: time,
            last: input,
            end: time,
        });
        if time < ends.start {
            (ends.first, ends.start) = (input, time);
        }
        if time > ends.end {
            (ends.last, ends.end) = (input, time);
        }
    }
    ends
}
