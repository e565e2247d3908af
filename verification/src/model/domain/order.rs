//! Chooses an action that may go first, because its time makes no difference.
//!
//! An action goes first if it commutes with all actions that can happen before it: every other
//! action that is possible now, or becomes possible while this one has not happened. Then one order
//! stands for all, and leads to the same quiet moments (a *persistent set* of one). There are no
//! cycles, since each action spends a frame, a connection or a part of the budget. The moments in
//! between are not visited.
//!
//! The arguments below rely on the tables of SPEC and on the order of queues. If a machine violated
//! them, this reduction might hide the effects. The tests therefore search small scopes without it,
//! too.
//!
//! **A node reads a frame that it does not answer** (LINK, WITHDRAWN, DECLARED of a ready node,
//! GOODBYE, or the end). That changes this node alone, and the frame was sent already. The death of
//! the node discards its state, whether the frame was read or not. Later frames of the Manager, and
//! its end, come after the frame. The end of a link at the other side has the same effect before
//! and after. Requests of the program do not commute (a WITHDRAW that crosses LINK is the
//! interesting case), so none may be left in the budget.
//!
//! **A node reads any frame.** Its answer is queued after its earlier frames. If the Manager ends,
//! the answer is lost, whether it was sent before or after. In addition to the above, the node must
//! not be able to die (the Manager would read the answer or not), to see a link end (the order of
//! two farewells matters), or to declare.
//!
//! **The Manager reads the answer to its own farewell.** It forgets that end and changes nothing
//! else. Every event that can come in between forgets the end, too.
//!
//! **The Manager reads HELLO, or DECLARE of a node that is resuming.** It changes that session
//! alone, since the node has no links, and no name or type is disputed. If the session ends, the
//! answer is lost, whether it was sent or not. The action does not commute with the end of the
//! Manager, or of the Manager's end of the connection.
//!
//! **The Manager reads CLAIM.** Two claims of one link have the same result in either order. CLAIM
//! also commutes with all actions that make links, because these leave out resuming sessions. But
//! the link must not be ending.
//!
//! **The last disconnected node connects.** The order of sessions is the same in any case.

use std::{collections::BTreeMap, rc::Rc};

use sm2_proto::{
    LinkId,
    control::{ToManager, ToNode},
};

use super::{
    Action, Budget, Scope,
    books::Side,
    program::{Connection, Down, Program},
    world::{Pair, Socket},
};

/// The parts of a moment that decide about the order of its actions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Order<'a> {
    pub(super) scope: &'a Scope,
    pub(super) programs: &'a [Rc<Program>],
    pub(super) pairs: &'a BTreeMap<LinkId, Pair>,
    pub(super) budget: Budget,
}

impl Order<'_> {
    /// An action of these that may go first.
    pub(super) fn goes_first(self, progress: &[Action]) -> Option<Action> {
        let first = |may: &dyn Fn(&Action) -> bool| progress.iter().copied().find(|it| may(it));
        let program = |at: u8| &*self.programs[usize::from(at)];
        first(&|action| match *action {
            Action::NodeReads(at) => self.reads_without_answer(program(at)),
            Action::ManagerReads(at) => reads_last_farewell(program(at)),
            _ => false,
        })
        .or_else(|| {
            first(&|action| match *action {
                Action::NodeReads(at) => self.reads_alone(at),
                Action::ManagerReads(at) => self.reads_of_one_session(program(at)),
                Action::Connects(at) => self.connects_last(at),
                _ => false,
            })
        })
    }

    const fn asks_nothing_more(self) -> bool {
        self.budget.withdrawals == 0 && self.budget.closes == 0
    }

    fn reads_without_answer(self, program: &Program) -> bool {
        let down = program.connection.as_ref().and_then(|it| it.down.front());
        let silent = match down {
            None => false,
            Some(Down::Eof) => true,
            Some(Down::Frame(frame, _)) => match frame.says {
                ToNode::Link { .. } | ToNode::Withdrawn { .. } | ToNode::Goodbye { .. } => true,
                ToNode::Declared { .. } => program.node.is_ready(),
                _ => false,
            },
        };
        silent && self.asks_nothing_more()
    }

    fn reads_alone(self, at: u8) -> bool {
        let program = &self.programs[usize::from(at)];
        let sees_an_end = self.pairs.values().any(|pair| {
            let mut ends = pair.ends.iter().zip(pair.sockets);
            let held = |(end, socket): (&_, _)| {
                let &(node, life, _) = end;
                (node, life) == (at, program.life) && socket == Socket::Held
            };
            pair.doomed && ends.any(held)
        });
        self.asks_nothing_more()
            && self.budget.node_crashes == 0
            && self.budget.stalls == 0
            && (self.scope.eager || program.undeclared.is_empty())
            && !sees_an_end
    }

    fn manager_stays(self) -> bool {
        let Budget {
            manager_crashes,
            stalls,
            shutdowns,
            ..
        } = self.budget;
        [manager_crashes, stalls, shutdowns] == [0; 3]
    }

    fn reads_of_one_session(self, program: &Program) -> bool {
        let Some((connection, frame)) = read_next(program) else {
            return false;
        };
        match frame {
            ToManager::Hello { .. } => self.manager_stays(),
            ToManager::Declare { .. } => connection.resuming && self.manager_stays(),
            ToManager::Claim { .. } => self.nothing_ends(),
            _ => false,
        }
    }

    fn nothing_ends(self) -> bool {
        let eager = self.scope.eager;
        let idle = |it: &Program| it.closed.is_empty() && (eager || it.undeclared.is_empty());
        self.budget == Budget::default()
            && self.pairs.values().all(|pair| !pair.doomed)
            && self.programs.iter().all(|it| idle(it))
    }

    fn connects_last(self, at: u8) -> bool {
        let mut others = (0_u8..).zip(self.programs).filter(|(it, _)| *it != at);
        let connected = |it: &Program| it.connection.as_ref().is_some_and(|it| !it.dead);
        self.budget.node_crashes == 0
            && self.manager_stays()
            && others.all(|(_, it)| connected(it) && it.closed.is_empty())
    }
}

/// The next frame that the Manager reads from a node, if it has read all earlier connections to their
/// end.
fn read_next(program: &Program) -> Option<(&Connection, &ToManager)> {
    let connection = program.connection.as_ref()?;
    let frame = connection.up.front()?;
    program
        .closed
        .is_empty()
        .then_some((connection, &frame.says))
}

fn reads_last_farewell(program: &Program) -> bool {
    match read_next(program) {
        Some((
            connection,
            &ToManager::Unlinked {
                interface, link, ..
            },
        )) => connection.books.has_said(Side::Manager, interface, link),
        _ => false,
    }
}
