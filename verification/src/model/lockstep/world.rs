//! One moment of a lockstep.

use std::collections::VecDeque;
use std::fmt;

use sm2_proto::clock::DomainTime;
use sm2_proto::lockstep::{
    Conductor, Done, Input, Member, MemberInput, MemberOutput, Output, Turn,
};
use sm2_proto::{Error, Instant, Machine, Name};

use super::expected;
use super::inputs::{Handled, INPUT_NS, Kind, TICK_NS};
use super::scope::{Fault, LockstepScope};
use crate::model::{Failure, Property, properties::fail};

/// A message in the queue of a subscriber.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Message {
    kind: Kind,
    published: Instant,
}

/// A node that is a member.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
struct Node {
    /// Its place in `World::nodes`.
    place: usize,
    machine: Member,
    /// The call that has not arrived.
    call: Option<Done>,
    /// Whether the conductor has a call of this node that it has not answered. Its answer to a call of a dead
    /// node does not arrive.
    waits: bool,
    /// The turn that has not arrived.
    turn: Option<Turn>,
    queue: Vec<Message>,
    taken: u64,
    /// The time of the next tick, from the first turn on.
    tick: Option<u64>,
    log: Vec<Handled>,
}

/// One moment.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct World {
    conductor: Conductor,
    nodes: Vec<Option<Node>>,
    /// The members whose end the conductor has not seen.
    ended: VecDeque<usize>,
    inputs: u8,
    deaths: u8,
    joins: u8,
    /// The number of rounds so far. Cuts have even moments, and publications odd ones.
    rounds: u64,
    /// Whether a member has left, or has joined after the first step.
    changed: bool,
}

/// An action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Action {
    /// A node finds the service, and joins.
    Join(usize),
    /// A call arrives.
    Call(usize),
    /// A turn arrives.
    Turn(usize),
    /// A member handles its next input.
    Handle(usize),
    /// A member has finished its turn.
    Finish(usize),
    /// The conductor publishes the next input, or lets domain time pass to the next tick.
    Step,
    /// A node dies.
    Die(usize),
    /// The conductor sees the end of a node.
    SeeEnd(usize),
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self, f)
    }
}

impl World {
    pub(super) fn new(scope: &LockstepScope) -> Self {
        Self {
            conductor: Conductor::new(),
            nodes: (0..scope.members).map(|at| Some(Node::at(at))).collect(),
            ended: VecDeque::new(),
            inputs: scope.inputs,
            deaths: scope.deaths,
            joins: scope.joins,
            rounds: 0,
            changed: false,
        }
    }

    pub(super) fn actions(&self, scope: &LockstepScope) -> Vec<Action> {
        let mut actions = Vec::new();
        let begun = self.rounds > 0;
        for (at, node) in self.nodes.iter().enumerate() {
            let Some(node) = node else {
                if self.joins > 0 {
                    actions.push(Action::Join(at));
                }
                continue;
            };
            if node.machine.is_free() && (!begun || self.joins > 0) {
                actions.push(Action::Join(at));
            }
            if node.call.is_some() {
                actions.push(Action::Call(at));
            }
            if node.turn.is_some() {
                actions.push(Action::Turn(at));
            }
            if let Some(turn) = node.machine.turn() {
                let next = node.next(scope, turn);
                if next.is_some() {
                    actions.push(Action::Handle(at));
                }
                if next.is_none() || scope.fault == Some(Fault::FinishesEarly) {
                    actions.push(Action::Finish(at));
                }
            }
            if begun && self.deaths > 0 {
                actions.push(Action::Die(at));
            }
        }
        // The owner waits for all members before the first step.
        let joined = self.conductor.members() == self.nodes.len();
        if self.inputs > 0 && !self.conductor.is_running() && (begun || joined) {
            actions.push(Action::Step);
        }
        if scope.fault != Some(Fault::EndUnseen) {
            actions.extend(self.ended.front().map(|at| Action::SeeEnd(*at)));
        }
        actions
    }

    pub(super) fn act(&mut self, scope: &LockstepScope, action: Action) -> Result<(), Failure> {
        match action {
            Action::Join(at) => self.join(at),
            Action::Call(at) => {
                let Some(node) = &mut self.nodes[at] else {
                    return Ok(());
                };
                let Some(done) = node.call.take() else {
                    return Ok(());
                };
                node.waits = true;
                self.conduct(scope, Input::Called(name(at), done))
            }
            Action::Turn(at) => {
                let Some(node) = &mut self.nodes[at] else {
                    return Ok(());
                };
                let Some(turn) = node.turn.take() else {
                    return Ok(());
                };
                node.taken = 0;
                node.feed(MemberInput::Turn(turn))?;
                if node.tick.is_none() {
                    node.tick = Some(turn.time.0 + TICK_NS);
                }
                Ok(())
            }
            Action::Handle(at) => {
                self.handle_next(scope, at);
                Ok(())
            }
            Action::Finish(at) => self.finish(scope, at),
            Action::Step => self.step(scope),
            Action::Die(at) => {
                self.deaths -= 1;
                self.changed = true;
                self.nodes[at] = None;
                self.ended.push_back(at);
                Ok(())
            }
            Action::SeeEnd(at) => {
                self.ended.pop_front();
                self.conduct(scope, Input::Left(name(at)))
            }
        }
    }

    fn join(&mut self, at: usize) -> Result<(), Failure> {
        if self.rounds > 0 {
            self.joins -= 1;
            self.changed = true;
        }
        // The new node has a link of its own under the same name, so the end of the old one is not seen any more.
        self.ended.retain(|it| *it != at);
        let node = self.nodes[at].get_or_insert_with(|| Node::at(at));
        node.feed(MemberInput::Found)
    }

    fn finish(&mut self, scope: &LockstepScope, at: usize) -> Result<(), Failure> {
        let Some(node) = &mut self.nodes[at] else {
            return Ok(());
        };
        let taken = match scope.fault {
            Some(Fault::TakenIsZero) => 0,
            _ => node.taken,
        };
        let tick = node.tick.filter(|_| scope.timer && at == 1);
        node.taken = 0;
        if scope.fault == Some(Fault::TurnTwice) {
            node.turn = node.machine.turn();
        }
        let next = tick.map(DomainTime);
        node.feed(MemberInput::Finished { taken, next })
    }

    /// Handles the next input of a member, and publishes the answer.
    fn handle_next(&mut self, scope: &LockstepScope, at: usize) {
        let published = Instant(2 * self.rounds + 1);
        let Some(node) = &mut self.nodes[at] else {
            return;
        };
        let Some(turn) = node.machine.turn() else {
            return;
        };
        let Some(kind) = node.next(scope, turn) else {
            return;
        };
        let place = node.queue.iter().position(|it| it.kind == kind);
        match place {
            Some(place) if kind != Kind::Tick => drop(node.queue.remove(place)),
            _ => node.tick = node.tick.map(|due| due + TICK_NS),
        }
        node.taken += 1;
        let (step, round) = (turn.step, turn.round);
        node.log.push(Handled { step, round, kind });
        if let Some(kind) = kind.answer(at) {
            self.publish(Message { kind, published });
        }
    }

    fn publish(&mut self, message: Message) {
        for (at, node) in self.nodes.iter_mut().enumerate() {
            // A node gets messages from its first call on: its links are open then.
            let node = node.as_mut().filter(|it| !it.machine.is_free());
            if let Some(node) = node.filter(|_| message.kind.is_for(at)) {
                node.queue.push(message);
            }
        }
    }

    fn step(&mut self, scope: &LockstepScope) -> Result<(), Failure> {
        let input = u64::from(scope.inputs - self.inputs + 1) * INPUT_NS;
        let time = match self.conductor.next() {
            Some(DomainTime(tick)) if tick < input => tick,
            _ => {
                self.inputs -= 1;
                self.publish(Message {
                    kind: Kind::Input,
                    published: Instant(2 * self.rounds + 1),
                });
                input
            }
        };
        self.conduct(scope, Input::Step(DomainTime(time)))
    }

    /// Feeds the conductor, and sends its turns.
    fn conduct(&mut self, scope: &LockstepScope, input: Input) -> Result<(), Failure> {
        let cut = match scope.fault {
            Some(Fault::CutEarly) => 2 * self.rounds,
            _ => 2 * (self.rounds + 1),
        };
        if let Err(Error::Ended(end)) = self.conductor.handle(Instant(cut), input) {
            return fail(Property::StepsEnd, end.to_string());
        }
        let mut sent = false;
        while let Some(output) = self.conductor.poll() {
            match output {
                Output::Turn(to, turn) => {
                    sent = true;
                    let node = number(&to).and_then(|at| self.nodes[at].as_mut());
                    if let Some(node) = node.filter(|it| it.waits) {
                        node.waits = false;
                        node.turn = Some(turn);
                    }
                }
                Output::Refuse(to, reason) => {
                    let what = format!("{to} is refused: {reason}");
                    return fail(Property::LockstepAccusesNobody, what);
                }
                Output::Superseded(_) => {}
                Output::StepEnded => self.check_inputs(scope)?,
            }
        }
        self.rounds += u64::from(sent);
        Ok(())
    }

    /// At the end of a step, members have handled everything that was published.
    fn check_inputs(&self, scope: &LockstepScope) -> Result<(), Failure> {
        let members = self.nodes.iter().flatten().filter(|it| it.tick.is_some());
        match members.flat_map(|it| &it.queue).next() {
            // The end of a member in the middle of its turn can leave messages for the next step.
            Some(message) if !self.changed => {
                let what = format!("step over in {scope:?}, but {message:?} is not handled");
                fail(Property::InputsAreFixed, what)
            }
            _ => Ok(()),
        }
    }

    pub(super) fn check(&self, scope: &LockstepScope, actions: &[Action]) -> Result<bool, Failure> {
        // A node that may still die does not make the others go on.
        let goes_on = |it: &Action| !matches!(it, Action::Die(_) | Action::Join(_));
        if actions.iter().any(goes_on) {
            return Ok(false);
        }
        if self.conductor.is_running() || (self.inputs > 0 && self.rounds > 0) {
            return fail(Property::StepsEnd, "a step does not end".to_owned());
        }
        if !self.changed && self.inputs == 0 {
            let logs = self.nodes.iter().flatten().map(|it| &it.log);
            let expected = expected::logs(scope);
            if !logs.eq(&expected) {
                let nodes = &self.nodes;
                let what = format!("expected {expected:?}, but the nodes are {nodes:?}");
                return fail(Property::InputsAreFixed, what);
            }
        }
        Ok(self.inputs == 0)
    }
}

impl Node {
    fn at(place: usize) -> Self {
        Self {
            place,
            ..Self::default()
        }
    }

    /// The next input of a turn: messages in the order of their topics, then a tick.
    fn next(&self, scope: &LockstepScope, turn: Turn) -> Option<Kind> {
        let is_in =
            |it: &&Message| it.published <= turn.cut || scope.fault == Some(Fault::IgnoresCut);
        let message = self.queue.iter().filter(is_in).map(|it| it.kind).min();
        let has_timer = scope.timer && Kind::Tick.is_for(self.place);
        let ticks = has_timer && self.tick.is_some_and(|due| due <= turn.time.0);
        message.or_else(|| ticks.then_some(Kind::Tick))
    }

    fn feed(&mut self, input: MemberInput) -> Result<(), Failure> {
        if let Err(error) = self.machine.handle(Instant(0), input) {
            return fail(Property::LockstepAccusesNobody, error.to_string());
        }
        while let Some(output) = self.machine.poll() {
            match output {
                MemberOutput::Call(done) => self.call = Some(done),
                MemberOutput::Work(_) => {}
            }
        }
        Ok(())
    }
}

const NAMES: [&str; 3] = ["detector", "filter", "logger"];

fn name(at: usize) -> Name {
    Name::new(NAMES[at]).expect("a legal name")
}

fn number(name: &Name) -> Option<usize> {
    NAMES.iter().position(|it| *it == name.as_str())
}
