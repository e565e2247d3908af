//! Breadth-first search through all moments; the trace of the first failure has the least steps.

use std::{
    collections::{HashSet, VecDeque},
    fmt,
    hash::{BuildHasherDefault, DefaultHasher, Hash, Hasher},
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};

use super::{Failure, Property};

/// How often a search reports its progress.
const TOLD_EVERY: Duration = Duration::from_secs(5);
/// The number of moments between two readings of the clock.
const LOOKED_EVERY: usize = 4_096;

/// A system whose reachable moments can be enumerated.
pub trait System {
    /// The whole state at one time. Parts that its hash leaves out must not affect later steps.
    type Moment: Hash;
    /// One action, with its text in a trace.
    type Action: Copy + fmt::Debug + fmt::Display;

    /// The first moment.
    ///
    /// # Errors
    ///
    /// The property that breaks on the way there.
    fn first(&self) -> Result<Self::Moment, Failure>;

    /// All possible actions, always in the same order.
    fn actions(&self, moment: &Self::Moment) -> Vec<Self::Action>;

    /// Checks a moment when `actions` are possible. Returns whether it is quiet.
    ///
    /// # Errors
    ///
    /// The first property that does not hold.
    fn check(&self, moment: &Self::Moment, actions: &[Self::Action]) -> Result<bool, Failure>;

    /// The moment after one of its actions.
    ///
    /// # Errors
    ///
    /// The property that the step breaks.
    fn step(&self, moment: &Self::Moment, action: Self::Action) -> Result<Self::Moment, Failure>;

    /// The fingerprint of a moment. Moments with equal fingerprints count as one: except for names, the
    /// same actions follow from them.
    fn print(&self, moment: &Self::Moment) -> u64 {
        let mut hasher = DefaultHasher::new();
        moment.hash(&mut hasher);
        hasher.finish()
    }
}

/// The result of a search.
#[derive(Debug)]
pub struct Report<A> {
    /// The number of different moments.
    pub states: usize,
    /// The number of steps between them.
    pub transitions: usize,
    /// The largest number of steps on a shortest path to a moment.
    pub depth: usize,
    /// The number of quiet moments.
    pub quiet: usize,
    /// The duration.
    pub time: Duration,
    /// True if the search stopped at its limit of states.
    pub cut_short: bool,
    /// The first failure.
    pub failure: Option<Counterexample<A>>,
}

impl<A> fmt::Display for Report<A> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            states,
            transitions,
            depth,
            quiet,
            ..
        } = self;
        write!(
            f,
            "{states} states, {transitions} transitions, depth {depth}, {quiet} quiet"
        )
    }
}

/// A trace that breaks a property.
#[derive(Debug)]
pub struct Counterexample<A> {
    /// The broken property.
    pub failure: Failure,
    /// The actions, in order.
    pub steps: Vec<A>,
}

/// The progress of a search.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// The number of moments reached so far.
    pub states: usize,
    /// The number of reached moments that were not visited yet.
    pub waiting: usize,
    /// The number of steps from the first moment to the current one.
    pub depth: usize,
}

/// Visits every moment, at most `limit`, up to the first failure.
#[must_use]
pub fn explore<S: System>(system: &S, limit: usize) -> Report<S::Action> {
    explore_telling(system, limit, |_| ())
}

/// As [`explore`], and reports its progress every few seconds.
#[must_use]
pub fn explore_telling<S: System>(
    system: &S,
    limit: usize,
    mut tell: impl FnMut(Progress),
) -> Report<S::Action> {
    let began = Instant::now();
    let mut told = began;
    let mut search = Search {
        system,
        seen: HashSet::default(),
        ways: Vec::new(),
        waiting: VecDeque::new(),
    };
    let mut report = Report {
        states: 0,
        transitions: 0,
        depth: 0,
        quiet: 0,
        time: Duration::ZERO,
        cut_short: false,
        failure: None,
    };
    match guarded(|| system.first()) {
        Ok(moment) => search.add(moment, None, 0),
        Err(failure) => report.failure = Some(search.trace(failure, None)),
    }
    let mut visited = 0_usize;
    while let Some((moment, at, depth)) = search.waiting.pop_front() {
        report.depth = depth;
        if let Err(failure) = expand(&moment, at, depth, &mut search, &mut report) {
            report.failure = Some(failure);
            break;
        }
        if search.ways.len() > limit {
            report.cut_short = true;
            break;
        }
        visited += 1;
        if visited.is_multiple_of(LOOKED_EVERY) && told.elapsed() >= TOLD_EVERY {
            told = Instant::now();
            tell(Progress {
                states: search.ways.len(),
                waiting: search.waiting.len(),
                depth,
            });
        }
    }
    report.states = search.ways.len();
    report.time = began.elapsed();
    report
}

fn expand<S: System>(
    moment: &S::Moment,
    at: usize,
    depth: usize,
    search: &mut Search<'_, S>,
    report: &mut Report<S::Action>,
) -> Result<(), Counterexample<S::Action>> {
    let system = search.system;
    let (actions, quiet) = guarded(|| {
        let actions = system.actions(moment);
        let quiet = system.check(moment, &actions)?;
        Ok((actions, quiet))
    })
    .map_err(|failure| search.trace(failure, Some((at, None))))?;
    report.quiet += usize::from(quiet);
    for (number, action) in actions.into_iter().enumerate() {
        let next = guarded(|| system.step(moment, action))
            .map_err(|failure| search.trace(failure, Some((at, Some(action)))))?;
        report.transitions += 1;
        search.add(next, Some((at, number)), depth + 1);
    }
    Ok(())
}

/// A panic of a machine is a failure like any other.
fn guarded<T>(step: impl FnOnce() -> Result<T, Failure>) -> Result<T, Failure> {
    catch_unwind(AssertUnwindSafe(step)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().cloned();
        let text = text.or_else(|| panic.downcast_ref::<&str>().map(ToString::to_string));
        Err(Failure {
            property: Property::Invariants,
            what: text.unwrap_or_default(),
        })
    })
}

/// A hasher that returns fingerprints unchanged: they are hashes already.
#[derive(Default)]
struct AsItIs(u64);

impl Hasher for AsItIs {
    fn write(&mut self, _: &[u8]) {
        unreachable!("a fingerprint is one number");
    }

    fn write_u64(&mut self, print: u64) {
        self.0 = print;
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

/// The first path to a moment: the index of the moment before, and of the action among its actions.
type Way = Option<(u32, u16)>;

struct Search<'a, S: System> {
    system: &'a S,
    /// The fingerprints of reached moments. Different moments with equal fingerprints would count as one;
    /// with 10^7 moments, the probability of that is about 3 in 10^6.
    seen: HashSet<u64, BuildHasherDefault<AsItIs>>,
    ways: Vec<Way>,
    waiting: VecDeque<(S::Moment, usize, usize)>,
}

impl<S: System> Search<'_, S> {
    fn add(&mut self, moment: S::Moment, way: Option<(usize, usize)>, depth: usize) {
        if self.seen.insert(self.system.print(&moment)) {
            self.waiting.push_back((moment, self.ways.len(), depth));
            let small = |(at, number)| {
                let at = u32::try_from(at).expect("fewer than 2^32 moments");
                (at, u16::try_from(number).expect("fewer than 2^16 actions"))
            };
            self.ways.push(way.map(small));
        }
    }

    /// Repeats the shortest path, to get its actions.
    fn trace(
        &self,
        failure: Failure,
        last: Option<(usize, Option<S::Action>)>,
    ) -> Counterexample<S::Action> {
        let mut numbers = Vec::new();
        let mut place = last.map(|(at, _)| at);
        while let Some((before, number)) = place.and_then(|at| self.ways[at]) {
            numbers.push(usize::from(number));
            place = usize::try_from(before).ok();
        }
        let mut steps = Vec::new();
        let mut moment = guarded(|| self.system.first()).ok();
        for number in numbers.into_iter().rev() {
            let Some(now) = moment else { break };
            let action = self.system.actions(&now)[number];
            steps.push(action);
            moment = guarded(|| self.system.step(&now, action)).ok();
        }
        steps.extend(last.and_then(|(_, action)| action));
        Counterexample { failure, steps }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers up to this one.
    struct Count(usize);

    impl System for Count {
        type Moment = usize;
        type Action = u8;

        fn first(&self) -> Result<usize, Failure> {
            Ok(0)
        }

        fn actions(&self, moment: &usize) -> Vec<u8> {
            vec![1; usize::from(*moment < self.0)]
        }

        fn check(&self, _: &usize, actions: &[u8]) -> Result<bool, Failure> {
            Ok(actions.is_empty())
        }

        fn step(&self, moment: &usize, action: u8) -> Result<usize, Failure> {
            Ok(moment + usize::from(action))
        }
    }

    #[test]
    fn progress_is_told_at_most_once_in_its_interval() {
        let end = 4 * LOOKED_EVERY;
        let mut told = 0;
        let report = explore_telling(&Count(end), usize::MAX, |_| told += 1);
        assert_eq!((report.states, report.depth), (end + 1, end));
        assert!(TOLD_EVERY * told <= report.time, "told {told} times");
    }
}
