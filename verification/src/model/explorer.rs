//! Breadth first through all moments; the first failure has a shortest trace.

use std::{
    collections::{HashSet, VecDeque},
    hash::{DefaultHasher, Hash, Hasher},
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};

use super::{Action, Failure, Property, Scope, World};

/// What a search has found.
#[derive(Debug)]
pub struct Report {
    /// Different moments.
    pub states: usize,
    /// Steps between them.
    pub transitions: usize,
    /// The longest of the shortest ways to a moment.
    pub depth: usize,
    /// Moments in which all was quiet.
    pub quiet: usize,
    /// How long it took.
    pub time: Duration,
    /// Whether the search stopped at its limit of states.
    pub cut_short: bool,
    /// The first failure.
    pub failure: Option<Counterexample>,
}

/// How a property comes to be broken.
#[derive(Debug)]
pub struct Counterexample {
    /// Which, and what was seen.
    pub failure: Failure,
    /// What happened, in order.
    pub steps: Vec<Action>,
}

/// Visits every moment of the scope, but no more than `limit`, up to the first failure.
#[must_use]
pub fn explore(scope: &Scope, limit: usize) -> Report {
    let began = Instant::now();
    let mut search = Search {
        seen: HashSet::new(),
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
    let first = guarded(|| World::new(scope));
    match first {
        Ok(world) => search.add(world, None, 0),
        Err(failure) => report.failure = Some(search.trace(failure, None)),
    }
    while let Some((world, at, depth)) = search.waiting.pop_front() {
        report.depth = depth;
        if let Err(failure) = expand(scope, &world, at, depth, &mut search, &mut report) {
            report.failure = Some(failure);
            break;
        }
        if search.ways.len() > limit {
            report.cut_short = true;
            break;
        }
    }
    report.states = search.ways.len();
    report.time = began.elapsed();
    report
}

fn expand(
    scope: &Scope,
    world: &World,
    at: usize,
    depth: usize,
    search: &mut Search,
    report: &mut Report,
) -> Result<(), Counterexample> {
    let (actions, quiet) = guarded(|| {
        let actions = world.actions(scope);
        let quiet = world.check(scope, &actions)?;
        Ok((actions, quiet))
    })
    .map_err(|failure| search.trace(failure, Some((at, None))))?;
    report.quiet += usize::from(quiet);
    for action in actions {
        let next = guarded(|| world.step(scope, action))
            .map_err(|failure| search.trace(failure, Some((at, Some(action)))))?;
        report.transitions += 1;
        search.add(next, Some((at, action)), depth + 1);
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

struct Search {
    /// Fingerprints: two moments of one print would count as one (with 10^7 moments the
    /// chance of that is about 3 in 10^6).
    seen: HashSet<u64>,
    /// How each moment was first reached.
    ways: Vec<Option<(usize, Action)>>,
    waiting: VecDeque<(World, usize, usize)>,
}

impl Search {
    fn add(&mut self, world: World, way: Option<(usize, Action)>, depth: usize) {
        let mut hasher = DefaultHasher::new();
        world.hash(&mut hasher);
        if self.seen.insert(hasher.finish()) {
            self.waiting.push_back((world, self.ways.len(), depth));
            self.ways.push(way);
        }
    }

    fn trace(&self, failure: Failure, last: Option<(usize, Option<Action>)>) -> Counterexample {
        let mut steps = Vec::new();
        if let Some((mut at, action)) = last {
            steps.extend(action);
            while let Some((before, action)) = self.ways[at] {
                steps.push(action);
                at = before;
            }
        }
        steps.reverse();
        Counterexample { failure, steps }
    }
}
