//! One moment of a link: two processes, and the frames between them.

use std::{
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};

use sm2_proto::{
    Instant,
    link::{self, Link, NoMemory, Packet, Role, SegmentInfo},
};

use super::{
    super::Failure,
    Action, Budget, LinkScope,
    books::{Flow, FlowLimits, Room},
    pool::{Pool, Slot},
    wire::Wire,
};

/// A link has no timer: time stands still.
pub(super) const NOW: Instant = Instant(1);

/// The life cycle of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Life {
    /// Its socket has not arrived.
    Unborn,
    Alive,
    Dead,
}

/// The location of a held message's payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Source {
    /// There is no payload.
    Nothing,
    /// A copy: the content itself.
    Copy(u64),
    /// In the memory of the other end.
    Slot(Slot),
}

/// One end: its machine, its driver, and its application.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct End {
    pub(super) link: Link,
    pub(super) life: Life,
    /// True if both OPEN frames were exchanged.
    pub(super) opened: bool,
    /// True if its program has closed it.
    pub(super) closed: bool,
    /// The reason of its end. Its socket is closed then.
    pub(super) over: Option<link::End>,
    /// The packet that the full socket refused.
    pub(super) kept: Option<Packet>,
    /// The memory that it sends from.
    pub(super) pool: Pool,
    /// The mapped segments of the other end.
    pub(super) mapped: BTreeMap<u32, SegmentInfo>,
    /// The content of sealed files of messages that were not taken yet.
    pub(super) files: BTreeMap<u64, u64>,
    /// The messages that the application holds.
    pub(super) held: BTreeMap<u64, Source>,
    /// The last publication, or the last call.
    pub(super) last: u64,
    /// Caller: calls that have not ended. Server: received requests without a reply.
    pub(super) calls: BTreeSet<u64>,
    /// Server: the calls among them that the application has taken.
    pub(super) taken: BTreeSet<u64>,
    /// Caller: calls that it cancelled. Server: calls that it knows to be cancelled.
    pub(super) cancelled: BTreeSet<u64>,
}

/// One moment.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct World {
    pub(super) ends: [Rc<End>; 2],
    /// The frames that each end has sent and the other one has not read.
    pub(super) wires: [Wire; 2],
    /// The messages of each end.
    pub(super) flows: [Flow; 2],
    pub(super) budget: Budget,
}

impl End {
    fn new(scope: &LinkScope, at: usize) -> Self {
        Self {
            link: Link::new(scope.config(at)),
            life: Life::Unborn,
            opened: false,
            closed: false,
            over: None,
            kept: None,
            pool: Pool::default(),
            mapped: BTreeMap::new(),
            files: BTreeMap::new(),
            held: BTreeMap::new(),
            last: 0,
            calls: BTreeSet::new(),
            taken: BTreeSet::new(),
            cancelled: BTreeSet::new(),
        }
    }

    /// True if the end has its socket.
    pub(super) fn is_connected(&self) -> bool {
        self.life == Life::Alive && self.over.is_none()
    }

    /// True if frames sent to the end are lost.
    pub(super) fn is_gone(&self) -> bool {
        self.life == Life::Dead || self.over.is_some()
    }
}

impl World {
    /// Both processes, before they have started.
    pub(super) fn new(scope: &LinkScope) -> Self {
        Self {
            ends: [0, 1].map(|at| Rc::new(End::new(scope, at))),
            wires: Default::default(),
            flows: Default::default(),
            budget: scope.budget,
        }
    }

    pub(super) fn end(&mut self, at: usize) -> &mut End {
        Rc::make_mut(&mut self.ends[at])
    }

    /// All possible actions.
    #[must_use]
    pub fn actions(&self, scope: &LinkScope) -> Vec<Action> {
        let mut actions = Vec::new();
        for (at, end) in (0_u8..).zip(&self.ends) {
            match end.life {
                Life::Unborn => actions.push(Action::Begins(at)),
                Life::Alive => self.add_progress(scope, at, end, &mut actions),
                Life::Dead => {}
            }
            if end.life != Life::Dead && self.budget.deaths > 0 {
                actions.push(Action::Dies(at));
            }
            if end.is_connected() {
                self.add_choices(scope, at, end, &mut actions);
            }
        }
        actions
    }

    fn add_progress(&self, scope: &LinkScope, at: u8, end: &End, actions: &mut Vec<Action>) {
        let from = 1 - usize::from(at);
        let (wire, flow) = (&self.wires[from], &self.flows[from]);
        if end.is_connected() && (wire.closed || !wire.queue.is_empty()) {
            actions.push(Action::Reads(at));
        }
        if end.kept.is_some() && !self.is_full(scope, usize::from(at)) {
            actions.push(Action::Flushes(at));
        }
        let limits = FlowLimits::new(scope, from);
        if flow.ready() > 0 && flow.may_take(&limits) {
            actions.push(Action::Takes(at));
        }
        actions.extend(flow.held().map(|it| Action::GivesBack(at, it)));
        // Only a server with an open link has such calls.
        for &call in &end.taken {
            let forms = scope.forms.iter().filter(|it| self.has(scope, 1, **it));
            actions.extend(forms.map(|form| Action::Replies(call, *form)));
        }
    }

    fn add_choices(&self, scope: &LinkScope, at: u8, end: &End, actions: &mut Vec<Action>) {
        let role = scope.config(usize::from(at)).role;
        if at == 0 {
            let room = self.room(scope, 0);
            let forms = scope.forms.iter().filter(|it| self.has(scope, 0, **it));
            if self.budget.messages > 0 && room != Room::None {
                actions.extend(forms.map(|form| Action::Sends(*form)));
            }
            if self.budget.skips > 0 && room == Room::None && role == Role::Sender {
                actions.push(Action::Skips);
            }
            if self.budget.cancels > 0 && role == Role::Caller {
                actions.extend((1..=end.last).map(Action::Cancels));
            }
        }
        if self.budget.retires > 0 && role.sends() {
            let idle = (0..scope.segments).filter(|it| end.pool.is_idle(*it));
            actions.extend(idle.map(|it| Action::Retires(at, it)));
        }
        if self.budget.closes > 0 {
            actions.push(Action::Closes(at));
        }
    }

    /// True if an end's socket accepts no more packets.
    pub(super) fn is_full(&self, scope: &LinkScope, at: usize) -> bool {
        !self.ends[1 - at].is_gone() && self.wires[at].queue.len() >= scope.socket
    }

    pub(super) fn room(&self, scope: &LinkScope, at: usize) -> Room {
        let limits = FlowLimits::new(scope, at);
        self.flows[at].room(&limits, self.ends[at].opened)
    }

    /// The moment after `action`, which is one of [`World::actions`].
    ///
    /// # Errors
    ///
    /// The property that the action broke.
    pub fn step(&self, scope: &LinkScope, action: Action) -> Result<Self, Failure> {
        let mut next = self.clone();
        match action {
            Action::Begins(at) => {
                next.end(at.into()).life = Life::Alive;
                next.drain(scope, at.into(), None)?;
            }
            Action::Reads(at) => next.read(scope, at.into())?,
            Action::Flushes(at) => next.flush(scope, at.into())?,
            Action::Takes(at) => next.take(scope, at.into())?,
            Action::GivesBack(at, sequence) => next.give_back(scope, at.into(), sequence)?,
            Action::Replies(call, form) => next.reply(scope, call, form)?,
            Action::Sends(form) => next.send(scope, form)?,
            Action::Skips => next.skip(scope)?,
            Action::Cancels(call) => next.cancel(scope, call)?,
            Action::Retires(at, segment) => next.retire(scope, at.into(), segment)?,
            Action::Closes(at) => next.close(scope, at.into())?,
            Action::Dies(at) => next.die(scope, at.into()),
        }
        next.clean_up();
        Ok(next)
    }

    /// Forgets state that no longer matters, as drivers do.
    fn clean_up(&mut self) {
        for at in [0, 1] {
            self.flows[at].forget();
            let end = &self.ends[at];
            if end.over.is_some() && end.link.untaken(&NoMemory) == 0 {
                let end = self.end(at);
                end.mapped.clear();
                end.files.clear();
            }
        }
    }
}
