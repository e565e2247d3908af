//! One moment of a domain: machines, frames in flight, ends of links. No kernel, no clock.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    hash::{Hash, Hasher},
    rc::Rc,
};

use sm2_proto::{Instant, LinkId, NodeId};

use super::{
    super::{Failure, Property},
    Budget, Scope,
    kept::Kept,
    policy::Policy,
    program::{End, Program},
    tape::{BEGIN, EPOCHS, Keys, SESSIONS},
};

/// The location of one end of a link's socket pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Socket {
    Underway,
    Held,
    Closed,
}

/// A link's two ends. Removed when both are closed.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Pair {
    pub(super) ends: [End; 2],
    pub(super) sockets: [Socket; 2],
    /// True if any side had a reason to end it.
    pub(super) doomed: bool,
}

/// One moment.
#[derive(Clone, Debug)]
pub struct World {
    pub(super) now: Instant,
    /// The number of Managers so far.
    pub(super) epoch: u64,
    pub(super) sessions: u64,
    pub(super) last_link: Option<LinkId>,
    pub(super) manager: Option<Rc<Kept>>,
    pub(super) programs: Vec<Rc<Program>>,
    pub(super) pairs: BTreeMap<LinkId, Pair>,
    pub(super) policy: Policy,
    /// Pairs that the present Manager need not link, since one of them ended its link.
    pub(super) broken: BTreeSet<[End; 2]>,
    pub(super) budget: Budget,
    /// The keys of all links so far.
    pub(super) keys: Rc<Keys>,
    /// The failure of the step that led here; the search does not continue from such a moment.
    pub(super) failure: Option<Failure>,
}

/// Hashes everything, without renumbering.
impl Hash for World {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.now, self.epoch, self.sessions, self.last_link).hash(state);
        self.manager.as_deref().map(Kept::machine).hash(state);
        (&self.programs, &self.pairs, &self.broken).hash(state);
        self.policy.hash(state);
        self.budget.hash(state);
    }
}

impl World {
    /// The first moment of a scope.
    ///
    /// # Errors
    ///
    /// The property that is broken on the way there.
    pub fn new(scope: &Scope) -> Result<Self, Failure> {
        let programs = 0..scope.programs.len();
        let mut world = Self {
            now: BEGIN,
            epoch: 0,
            sessions: 0,
            last_link: None,
            manager: None,
            programs: programs
                .map(|at| Rc::new(Program::new(at, 0, scope)))
                .collect(),
            pairs: BTreeMap::new(),
            policy: Policy::default(),
            broken: BTreeSet::new(),
            budget: scope.budget,
            keys: Rc::default(),
            failure: None,
        };
        world.begin(scope);
        if scope.starts_linked {
            while let Some(&action) = world.progress().first() {
                world = world.step(scope, action)?;
            }
        }
        Ok(world)
    }

    /// The number of the next connection.
    pub(super) const fn next_session(&mut self) -> NodeId {
        self.sessions += 1;
        NodeId(SESSIONS + self.sessions)
    }

    pub(super) const fn epoch_number(&self) -> u64 {
        EPOCHS + self.epoch
    }

    pub(super) fn program(&mut self, at: u8) -> &mut Program {
        let program = Rc::make_mut(&mut self.programs[usize::from(at)]);
        program.taped.forget();
        program
    }

    pub(super) fn fail(&mut self, property: Property, what: impl fmt::Display) {
        let what = what.to_string();
        self.failure.get_or_insert(Failure { property, what });
    }
}

pub(super) fn end_of(ends: &[End; 2], end: End) -> usize {
    usize::from(ends[0] != end)
}
