//! The actions that are possible in a moment.

use sm2_proto::{
    Datagram, InterfaceId, Machine,
    manager::{self, Manager},
    node,
};

use super::{
    Action, Scope,
    order::Order,
    program::Connection,
    world::{Socket, World, end_of},
};

impl World {
    /// Returns all possible actions. In a reduced scope, returns a single action if one may go
    /// first.
    #[must_use]
    pub fn actions(&self, scope: &Scope) -> Vec<Action> {
        let mut actions = self.progress();
        let order = Order {
            scope,
            programs: &self.programs,
            pairs: &self.pairs,
            budget: self.budget,
        };
        if scope.reduced
            && let Some(first) = order.goes_first(&actions)
        {
            return vec![first];
        }
        self.add_choices(scope, &mut actions);
        actions
    }

    /// The actions that happen sooner or later without a choice.
    pub(super) fn progress(&self) -> Vec<Action> {
        let mut actions = Vec::new();
        let manager = self.manager.as_ref().map(|it| it.machine());
        let alive = manager.is_some();
        if !alive {
            actions.push(Action::ManagerBegins);
        }
        let deadline = manager.and_then(Manager::deadline);
        if deadline.is_some_and(|it| it <= self.now) {
            actions.push(Action::ManagerWorks);
        }
        for (at, program) in (0_u8..).zip(&self.programs) {
            let open = program.connection.as_ref();
            let unread = open.filter(|it| !it.up.is_empty());
            let unread = program.closed.front().or(unread);
            //= SM2-SES-009 model
            let may_read = |it: &Connection| manager.is_some_and(|of| !of.is_busy(it.session));
            if unread.is_some_and(may_read) {
                actions.push(Action::ManagerReads(at));
            }
            if open.is_some_and(|it| !it.down.is_empty()) {
                actions.push(Action::NodeReads(at));
            }
            // A Manager reads the ends of old connections before it accepts new ones.
            if alive && open.is_none() && program.closed.is_empty() {
                actions.push(Action::Connects(at));
            }
            for &(interface, link) in &program.links {
                let pair = &self.pairs[&link];
                let ours = end_of(&pair.ends, (at, program.life, interface));
                if pair.sockets[1 - ours] == Socket::Closed {
                    actions.push(Action::Notices(at, interface, link));
                }
            }
        }
        if actions.is_empty() && deadline.is_some() {
            actions.push(Action::TimePasses);
        }
        actions
    }

    /// Adds the actions that cost a part of the budget, as far as it lasts.
    fn add_choices(&self, scope: &Scope, actions: &mut Vec<Action>) {
        let alive = self.manager.is_some();
        for (at, program) in (0_u8..).zip(&self.programs) {
            if !scope.eager && !program.undeclared.is_empty() && self.can_declare(at) {
                actions.push(Action::Declares(at));
            }
            if self.budget.withdrawals > 0 {
                for &interface in program.interfaces.keys() {
                    let withdraw = node::Input::Withdraw { interface };
                    // An interface that is being declared cannot be withdrawn.
                    if program.node.clone().handle(self.now, withdraw).is_ok() {
                        actions.push(Action::Withdraws(at, interface));
                    }
                }
            }
            if self.budget.closes > 0 {
                let links = program.links.iter();
                actions.extend(links.map(|&(interface, link)| Action::Closes(at, interface, link)));
            }
            if self.budget.node_crashes > 0 && program.begun {
                actions.push(Action::NodeDies(at));
            }
            let open = program.connection.as_ref().filter(|it| !it.dead);
            if self.budget.stalls > 0 && alive && open.is_some() {
                actions.push(Action::Stalls(at));
            }
        }
        if self.budget.reloads > 0 {
            actions.push(Action::PolicyChanges);
        }
        if self.budget.shutdowns > 0 && alive {
            actions.push(Action::ManagerShutsDown);
        }
        if self.budget.manager_crashes > 0 && alive {
            actions.push(Action::ManagerDies);
            for (at, program) in (0_u8..).zip(&self.programs) {
                let open = program.connection.as_ref();
                if !program.closed.is_empty() || open.is_some_and(|it| !it.up.is_empty()) {
                    let frames = self.frames_of_answer(at);
                    actions.extend((1..frames).map(|sent| Action::ManagerDiesAnswering(at, sent)));
                }
            }
        }
    }

    fn can_declare(&self, at: u8) -> bool {
        let mut node = self.programs[usize::from(at)].node.clone();
        // Before WELCOME no interface can be withdrawn, whatever its number.
        !matches!(
            node.handle(
                self.now,
                node::Input::Withdraw {
                    interface: InterfaceId(0)
                }
            ),
            Err(node::Error::Misuse(node::Misuse::NotReady) | node::Error::Ended(_))
        )
    }

    /// How many frames the Manager would send in answer to a node's next frame.
    fn frames_of_answer(&self, at: u8) -> u8 {
        let program = &self.programs[usize::from(at)];
        let connection = program.closed.front().or(program.connection.as_ref());
        let (Some(connection), Some(manager)) = (connection, &self.manager) else {
            return 0;
        };
        let session = connection.session;
        let mut manager = Manager::clone(manager.machine());
        let input = match connection.up.front() {
            Some(frame) => manager::Input::Datagram {
                session,
                datagram: Datagram::new(&frame.bytes),
            },
            None => manager::Input::Closed { session },
        };
        if manager.handle(self.now, input).is_err() {
            return 0;
        }
        let frames = std::iter::from_fn(|| manager.poll()).map(|output| match output {
            manager::Output::Link { .. } => 2,
            manager::Output::Send { .. } => 1,
            _ => 0,
        });
        frames.sum()
    }
}
