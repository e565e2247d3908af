//! The effect of each action on a moment.

use sm2_proto::control::{Limit, Limits};
use std::{rc::Rc, sync::Arc};

use sm2_proto::{
    Code, Farewell, InterfaceId, LinkId, Machine,
    manager::{self, Manager},
    node,
};

use super::{
    super::{Failure, Property},
    Action, Fault, Scope,
    books::Books,
    kept::Kept,
    program::{Down, End, Program},
    tape::BEGIN,
    world::{Socket, World},
};

impl World {
    /// The moment after `action`, which is one of [`World::actions`].
    ///
    /// # Errors
    ///
    /// The property that the action broke.
    pub fn step(&self, scope: &Scope, action: Action) -> Result<Self, Failure> {
        let mut next = self.clone();
        match action {
            Action::ManagerReads(at) => next.manager_reads(scope, at, usize::MAX),
            Action::NodeReads(at) => next.node_reads(scope, at),
            Action::Connects(at) => next.connect(scope, at),
            Action::Notices(at, interface, link) => next.notice(scope, at, interface, link),
            Action::ManagerBegins => next.begin(scope),
            Action::ManagerWorks => next.feed_manager(scope, manager::Input::Tick, usize::MAX),
            Action::TimePasses => {
                let deadline = |it: &Self| it.manager.as_ref()?.machine().deadline();
                next.now = deadline(&next).unwrap_or(next.now);
                // A tick gives up the claims of one session. All of them come before other inputs.
                while deadline(&next).is_some_and(|it| it <= next.now) {
                    next.feed_manager(scope, manager::Input::Tick, usize::MAX);
                }
            }
            Action::Declares(at) => {
                next.declare(scope, at);
                next.node_works(scope, at, None);
            }
            Action::Withdraws(at, interface) => next.withdraw(scope, at, interface),
            Action::Closes(at, interface, link) => {
                next.budget.closes -= 1;
                next.doom(link);
                let mut ends = next.pairs[&link].ends;
                ends.sort_unstable();
                next.broken.insert(ends);
                next.close_end(at, interface, link);
                next.say_unlinked(scope, at, interface, link, Code(71));
            }
            Action::NodeDies(at) => next.node_dies(scope, at),
            Action::Stalls(at) => next.stall(scope, at),
            Action::PolicyChanges => {
                next.budget.reloads -= 1;
                next.policy.restricted = !next.policy.restricted;
                next.policy.reloaded = next.manager.is_some();
                next.doom_restricted(scope);
                if scope.fault != Some(Fault::PolicyLost) {
                    let policy = next.policy.access(scope).map(Arc::new);
                    let input = manager::Input::SetAccessPolicy(policy);
                    next.feed_manager(scope, input, usize::MAX);
                }
            }
            Action::ManagerDies => {
                next.budget.manager_crashes -= 1;
                next.manager_ends();
            }
            Action::ManagerDiesAnswering(at, sent) => {
                next.budget.manager_crashes -= 1;
                next.manager_reads(scope, at, usize::from(sent));
                next.manager_ends();
            }
            Action::ManagerShutsDown => {
                next.budget.shutdowns -= 1;
                next.feed_manager(scope, manager::Input::Shutdown, usize::MAX);
                next.manager_ends();
            }
        }
        match next.failure.take() {
            Some(failure) => Err(failure),
            None => Ok(next),
        }
    }

    pub(super) fn begin(&mut self, scope: &Scope) {
        if scope.fault != Some(Fault::EpochAgain) || self.epoch == 0 {
            self.epoch += 1;
        }
        // No node requests changes here; pages are requested.
        let limits = Limits::default()
            .with(Limit::ChangesRemembered, 0)
            .with(Limit::WorkPerTurn, scope.work_per_turn);
        let epoch = self.epoch_number();
        let manager = Manager::new(epoch, epoch.into(), limits);
        let manager = match self.policy.access(scope) {
            Some(access) => manager.with_access_policy(access),
            None => manager,
        };
        self.manager = Some(Rc::new(Kept::new(manager)));
        self.policy.reloaded = false;
        self.sessions = 0;
        self.now = BEGIN;
        self.broken.clear();
        self.doom_restricted(scope);
    }

    pub(super) fn declare(&mut self, scope: &Scope, at: u8) {
        let program = self.program(at);
        let Some(place) = program.undeclared.pop_first() else {
            return;
        };
        let contract = scope.programs[usize::from(at)][usize::from(place)].clone();
        match program.node.declare(contract) {
            Ok(interface) => drop(program.interfaces.insert(interface, place)),
            Err(error) => self.fail(Property::Invariants, error),
        }
    }

    fn withdraw(&mut self, scope: &Scope, at: u8, interface: InterfaceId) {
        self.budget.withdrawals -= 1;
        let program = self.program(at);
        let life = program.life;
        program.live.remove(&interface);
        if let Some(place) = program.interfaces.remove(&interface) {
            program.undeclared.insert(place);
        }
        let links: Vec<_> = program.links.iter().copied().collect();
        self.doom_all(|end| *end == (at, life, interface));
        for (_, link) in links.into_iter().filter(|(of, _)| *of == interface) {
            self.close_end(at, interface, link);
        }
        self.broken
            .retain(|ends| !ends.contains(&(at, life, interface)));
        self.feed_node(scope, at, node::Input::Withdraw { interface }, None);
        if scope.eager {
            self.declare(scope, at);
            self.node_works(scope, at, None);
        }
    }

    fn notice(&mut self, scope: &Scope, at: u8, interface: InterfaceId, link: LinkId) {
        self.close_end(at, interface, link);
        if scope.fault == Some(Fault::HangUpUnsaid) {
            return;
        }
        let code = Farewell::PeerGone.code();
        self.say_unlinked(scope, at, interface, link, code);
    }

    fn node_dies(&mut self, scope: &Scope, at: u8) {
        self.budget.node_crashes -= 1;
        let life = self.programs[usize::from(at)].life;
        self.doom_all(|end| (end.0, end.1) == (at, life));
        self.forget_broken(at, life);
        self.hang_up(at);
        for (interface, link) in self.program(at).links.clone() {
            self.close_end(at, interface, link);
        }
        let closed = std::mem::take(&mut self.program(at).closed);
        *self.program(at) = Program::new(usize::from(at), life + 1, scope);
        self.program(at).closed = closed;
        if scope.fault == Some(Fault::EndUnseen) {
            self.program(at).closed.clear();
        }
    }

    /// Forgets the broken pairs of a session that has ended, as the Manager does.
    fn forget_broken(&mut self, at: u8, life: u8) {
        self.broken
            .retain(|ends| !ends.iter().any(|end| (end.0, end.1) == (at, life)));
    }

    /// A node's queue is full, and the Manager gives the node up. The Manager reads no more of the
    /// node's frames. Its own sent frames still arrive, but there is no room for GOODBYE.
    fn stall(&mut self, scope: &Scope, at: u8) {
        self.budget.stalls -= 1;
        let program = self.program(at);
        let life = program.life;
        let Some(connection) = &mut program.connection else {
            return;
        };
        let session = connection.session;
        connection.end();
        self.doom_all(|end| (end.0, end.1) == (at, life));
        self.forget_broken(at, life);
        self.feed_manager(scope, manager::Input::Stalled { session }, usize::MAX);
    }

    /// A node closes its end of its connection. Frames that it has not read are lost.
    pub(super) fn hang_up(&mut self, at: u8) {
        let Some(mut connection) = self.program(at).connection.take() else {
            return;
        };
        for down in std::mem::take(&mut connection.down) {
            if let Down::Frame(_, Some((link, interface))) = down {
                self.lose((at, connection.life, interface), link);
            }
        }
        if !connection.dead {
            // The remaining farewells will not be received.
            connection.books = Books::default();
            self.program(at).closed.push_back(connection);
        }
    }

    fn manager_ends(&mut self) {
        self.manager = None;
        for at in (0_u8..).take(self.programs.len()) {
            let program = self.program(at);
            program.closed.clear();
            if let Some(connection) = &mut program.connection {
                connection.end();
            }
        }
    }

    /// Links that the policy in force may end.
    fn doom_restricted(&mut self, scope: &Scope) {
        let concerned = self.policy.concerned(scope, &self.programs);
        self.doom_all(|end| concerned.contains(end));
    }

    pub(super) fn doom(&mut self, link: LinkId) {
        if let Some(pair) = self.pairs.get_mut(&link) {
            pair.doomed = true;
        }
    }

    pub(super) fn doom_all(&mut self, touched: impl Fn(&End) -> bool) {
        for pair in self.pairs.values_mut() {
            pair.doomed |= pair.ends.iter().any(&touched);
        }
    }

    pub(super) fn close_end(&mut self, at: u8, interface: InterfaceId, link: LinkId) {
        let program = self.program(at);
        program.links.remove(&(interface, link));
        let end = (at, program.life, interface);
        self.set_socket(link, |it| *it == end, Socket::Closed);
    }

    /// A descriptor that was never received.
    pub(super) fn lose(&mut self, end: End, link: LinkId) {
        self.doom(link);
        self.set_socket(link, |it| *it == end, Socket::Closed);
    }

    pub(super) fn set_socket(
        &mut self,
        link: LinkId,
        which: impl FnMut(&End) -> bool,
        socket: Socket,
    ) {
        let Some(pair) = self.pairs.get_mut(&link) else {
            return;
        };
        if let Some(place) = pair.ends.iter().position(which) {
            pair.sockets[place] = socket;
        }
        if pair.sockets == [Socket::Closed; 2] {
            let doomed = pair.doomed;
            self.pairs.remove(&link);
            if !doomed {
                self.fail(
                    Property::LinksSurvive,
                    format_args!("{link} was lost for nothing"),
                );
            }
        }
    }
}
