//! The conductor of a lockstep: the members' calls, and their turns.

use std::collections::{BTreeSet, HashMap};

use sm2_node::clock::DomainTime;
use sm2_node::lockstep::{LockstepDone, LockstepTurn, SERVICE};
use sm2_node::{DeclareError, Event, Events, Node, RecvError, Request, Server, WaitSet};
use sm2_proto::lockstep::{Input, Misuse, Output, TooManyRounds};
use sm2_proto::{Error, Machine, Name};

use crate::error::PlayError;

/// The service `lockstep`, and its machine.
pub(super) struct Conductor {
    server: Server<LockstepDone, LockstepTurn>,
    events: Events,
    machine: sm2_proto::lockstep::Conductor,
    /// The calls that wait for a turn.
    calls: HashMap<Name, Request<LockstepDone, LockstepTurn>>,
    /// The members that left.
    left: BTreeSet<Name>,
}

impl Conductor {
    pub(super) fn new(node: &Node) -> Result<Self, DeclareError> {
        let server = node.server(SERVICE)?;
        Ok(Self {
            events: server.events(),
            server,
            machine: sm2_proto::lockstep::Conductor::new(),
            calls: HashMap::new(),
            left: BTreeSet::new(),
        })
    }

    /// Adds its sources to a set.
    pub(super) fn add_to<T: Clone>(&self, set: &mut WaitSet<'_, T>, tag: T) -> std::io::Result<()> {
        set.add(&self.server, tag.clone())?;
        set.add(&self.events, tag)?;
        Ok(())
    }

    pub(super) fn members(&self) -> usize {
        self.machine.members()
    }

    pub(super) const fn is_running(&self) -> bool {
        self.machine.is_running()
    }

    /// The time when the first timer of a member is due.
    pub(super) fn next(&self) -> Option<DomainTime> {
        self.machine.next()
    }

    /// The members that left.
    pub(super) fn left(&self) -> impl Iterator<Item = &Name> {
        self.left.iter()
    }

    /// Begins a step, whose inputs were published.
    pub(super) fn begin(&mut self, time: DomainTime) -> Result<(), TooManyRounds> {
        self.handle(Input::Step(time))
    }

    /// Handles calls, and members that left.
    pub(super) fn pump(&mut self) -> Result<(), PlayError> {
        // First, because a program that has left may join again under the same name.
        while let Some(event) = self.events.try_next()? {
            if let Event::Left { peer, .. } = event {
                self.calls.remove(&peer.name);
                self.leave(peer.name.clone())?;
            }
        }
        if self.events.dropped() > 0 {
            self.look_for_members()?;
        }
        loop {
            match self.server.try_recv() {
                Ok(Some(request)) => self.called(request)?,
                Ok(None) => break,
                // The library has answered it.
                Err(RecvError::Payload { .. }) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// Some events were displaced, so links tell who is there.
    fn look_for_members(&mut self) -> Result<(), TooManyRounds> {
        let links = self.server.links();
        let here: BTreeSet<_> = links
            .iter()
            .filter(|it| it.open)
            .map(|it| &it.peer.name)
            .collect();
        let waiting = self.calls.keys();
        let known = waiting.chain(self.machine.working());
        let gone: Vec<_> = known.filter(|it| !here.contains(it)).cloned().collect();
        for name in gone {
            self.calls.remove(&name);
            self.leave(name)?;
        }
        Ok(())
    }

    fn leave(&mut self, name: Name) -> Result<(), TooManyRounds> {
        self.left.insert(name.clone());
        self.handle(Input::Left(name))
    }

    fn called(
        &mut self,
        request: Request<LockstepDone, LockstepTurn>,
    ) -> Result<(), TooManyRounds> {
        let name = request.client().clone();
        let done = sm2_proto::lockstep::Done::from(*request);
        // A call that waited is answered as failed here: a member has one call at a time.
        drop(self.calls.insert(name.clone(), request));
        self.left.remove(&name);
        self.handle(Input::Called(name, done))
    }

    fn handle(&mut self, input: Input) -> Result<(), TooManyRounds> {
        let fed = self.machine.handle(sm2_io::clock::now(), input);
        while let Some(output) = self.machine.poll() {
            match output {
                Output::Turn(name, turn) => {
                    if let Some(call) = self.calls.remove(&name) {
                        // A member that is gone is reported as such.
                        let _ = call.reply(&turn.into());
                    }
                }
                Output::Refuse(name, reason) => {
                    if let Some(call) = self.calls.remove(&name) {
                        let _ = call.fail(&reason.to_string());
                    }
                    self.left.insert(name);
                }
                // The call was replaced when the newer one came.
                Output::Superseded(_) | Output::StepEnded => {}
            }
        }
        match fed {
            Ok(()) => Ok(()),
            Err(Error::Ended(end)) => Err(end),
            Err(Error::Misuse(misuse @ (Misuse::Running { .. } | Misuse::Back))) => {
                unreachable!("{misuse}")
            }
        }
    }
}
