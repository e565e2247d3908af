//! The model's scopes as models of stateright.
//!
//! stateright requires states that can be sent between threads, and moments of the model cannot be.
//! Therefore a [`Shown`] is the path to a moment, which is computed again where it is needed. That
//! is slow, but fast enough for scopes of some ten thousand moments.

use std::{
    any::Any,
    cell::RefCell,
    fmt,
    hash::{Hash, Hasher},
    sync::Arc,
};

use sm2_verification::model::{Failure, Report, System};
use stateright::{Checker, Model, Property};

/// The property that holds in each state if nothing is broken.
pub const HOLDS: &str = "nothing is broken";
/// The property that holds in some states.
pub const QUIET: &str = "all is quiet";

/// A scope whose moments can be shown.
pub struct Watched<S> {
    system: Arc<S>,
}

/// A moment, given by the path to it.
pub struct Shown<S: System> {
    system: Arc<S>,
    way: Vec<S::Action>,
    print: u64,
    /// `Ok(true)` if all is quiet, or the broken property.
    verdict: Result<bool, Failure>,
}

/// The counts of stateright's search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counted {
    /// Different states.
    pub states: usize,
    /// Steps between them.
    pub transitions: usize,
    /// The length of the longest of the shortest paths to a state.
    pub depth: usize,
    /// True if no property was broken.
    pub held: bool,
}

impl<A> From<Report<A>> for Counted {
    fn from(report: Report<A>) -> Self {
        Self {
            states: report.states,
            transitions: report.transitions,
            depth: report.depth,
            held: report.failure.is_none(),
        }
    }
}

/// Scopes that can be shown.
pub trait Watchable:
    System<Moment: fmt::Debug, Action: PartialEq + Send + Sync> + Send + Sync + 'static
{
}
impl<S> Watchable for S where
    S: System<Moment: fmt::Debug, Action: PartialEq + Send + Sync> + Send + Sync + 'static
{
}

/// Searches a scope with stateright, breadth first.
pub fn count<S: Watchable>(system: S) -> Counted {
    let checker = Watched::new(system).checker().threads(1);
    let checker = checker.spawn_bfs().join();
    Counted {
        states: checker.unique_state_count(),
        // stateright counts visits of states, and calls the depth of the first one 1.
        transitions: checker.state_count() - 1,
        depth: checker.max_depth() - 1,
        held: checker.discovery(HOLDS).is_none(),
    }
}

impl<S> Watched<S> {
    /// Makes a scope that can be shown.
    pub fn new(system: S) -> Self {
        Self {
            system: Arc::new(system),
        }
    }
}

impl<S: Watchable> Model for Watched<S> {
    type State = Shown<S>;
    type Action = S::Action;

    fn init_states(&self) -> Vec<Self::State> {
        vec![Shown::new(&self.system, Vec::new())]
    }

    fn actions(&self, state: &Self::State, actions: &mut Vec<Self::Action>) {
        // No state follows a broken one.
        if state.verdict.is_ok() {
            actions.extend(
                state
                    .with_moment(|it| self.system.actions(it))
                    .unwrap_or_default(),
            );
        }
    }

    fn next_state(&self, state: &Self::State, action: Self::Action) -> Option<Self::State> {
        let mut way = state.way.clone();
        way.push(action);
        Some(Shown::new(&self.system, way))
    }

    fn format_action(&self, action: &Self::Action) -> String {
        action.to_string()
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always(HOLDS, |_, state: &Shown<S>| state.verdict.is_ok()),
            Property::sometimes(QUIET, |_, state: &Shown<S>| state.verdict == Ok(true)),
        ]
    }
}

/// The moment that a thread has computed last.
struct Made<S: System> {
    system: Arc<S>,
    way: Vec<S::Action>,
    moment: S::Moment,
}

thread_local! {
    static LAST: RefCell<Option<Box<dyn Any>>> = const { RefCell::new(None) };
}

impl<S: Watchable> Shown<S> {
    fn new(system: &Arc<S>, way: Vec<S::Action>) -> Self {
        let judged = match way.split_last() {
            None => system.first().and_then(|it| judge(&**system, &it)),
            Some((action, before)) => made(system, before, |it| system.step(it, *action))
                .and_then(|it| it)
                .and_then(|it| judge(&**system, &it)),
        };
        let (print, verdict) = match judged {
            Ok((print, quiet)) => (print, Ok(quiet)),
            // All broken states count as one.
            Err(failure) => (0, Err(failure)),
        };
        Self {
            system: Arc::clone(system),
            way,
            print,
            verdict,
        }
    }

    /// Computes the moment and passes it to `look`.
    fn with_moment<T>(&self, look: impl FnOnce(&S::Moment) -> T) -> Result<T, Failure> {
        made(&self.system, &self.way, look)
    }
}

/// The fingerprint of a moment, and whether all is quiet in it.
fn judge<S: System>(system: &S, moment: &S::Moment) -> Result<(u64, bool), Failure> {
    let quiet = system.check(moment, &system.actions(moment))?;
    Ok((system.print(moment), quiet))
}

/// Computes the moment at the end of a path.
fn made<S: Watchable, T>(
    system: &Arc<S>,
    way: &[S::Action],
    look: impl FnOnce(&S::Moment) -> T,
) -> Result<T, Failure> {
    let is_it = |it: &&Made<S>| Arc::ptr_eq(&it.system, system) && it.way == way;
    LAST.with_borrow_mut(|last| {
        let found = last.as_ref().and_then(|it| it.downcast_ref()).filter(is_it);
        if let Some(Made { moment, .. }) = found {
            return Ok(look(moment));
        }
        let mut moment = system.first()?;
        for action in way {
            moment = system.step(&moment, *action)?;
        }
        let seen = look(&moment);
        *last = Some(Box::new(Made {
            system: Arc::clone(system),
            way: way.to_vec(),
            moment,
        }));
        Ok(seen)
    })
}

impl<S: System> Clone for Shown<S> {
    fn clone(&self) -> Self {
        Self {
            system: Arc::clone(&self.system),
            way: self.way.clone(),
            print: self.print,
            verdict: self.verdict.clone(),
        }
    }
}

impl<S: System> PartialEq for Shown<S> {
    fn eq(&self, other: &Self) -> bool {
        (self.print, &self.verdict) == (other.print, &other.verdict)
    }
}

impl<S: System> Hash for Shown<S> {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        (self.print, &self.verdict).hash(hasher);
    }
}

impl<S: Watchable> fmt::Debug for Shown<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.verdict {
            Ok(true) => writeln!(f, "all is quiet")?,
            Ok(false) => {}
            Err(failure) => return write!(f, "{failure}"),
        }
        match self.with_moment(|it| write!(f, "{it:#?}")) {
            Ok(written) => written,
            Err(failure) => write!(f, "{failure}"),
        }
    }
}
