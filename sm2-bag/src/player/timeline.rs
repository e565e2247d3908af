//! The waits of a player, and domain time.
//!
//! A player has one pace and one wait set. A pause and another rate begin at the recorded time that the replay has
//! reached, so no message is overdue after them. Keys, threads and the service `play/control` change one state, and the
//! wait set wakes the player, which compares the state with its pace.

use std::io;
use std::os::fd::BorrowedFd;

use sm2_node::clock::{ClockReading, ClockSource, DomainTime};
use sm2_node::wait_set::Interest;
use sm2_node::{Node, PublishError, WaitError, WaitSet};
use sm2_proto::{Instant, Name};

use super::conductor::Conductor;
use super::control::PlayControl;
use super::pace::Pace;
use super::service::ControlService;
use crate::error::PlayError;

/// Lets a replay go on at its pace, and in lockstep at that of the members. Each wait also handles commands and calls;
/// it returns false if the replay has to end.
pub(super) struct Timeline<'fd> {
    set: WaitSet<'fd, Ready>,
    control: PlayControl,
    service: Option<ControlService>,
    conductor: Option<Conductor>,
    clock: Option<ClockSource>,
    /// The reading that was published last.
    reading: Option<ClockReading>,
    /// `None` before the first message.
    pace: Option<Pace>,
    /// Whether a command has demanded the present step.
    in_step: bool,
    /// The time of the messages that were published and not passed on to the members.
    inputs: Option<DomainTime>,
}

/// The sources that end a sleep.
#[derive(Clone, Copy)]
enum Ready {
    /// The caller ends playing.
    Stop,
    /// Another thread has given a command.
    Command,
    /// Another program calls the service for commands.
    Call,
    /// A member of the lockstep has called or left.
    Member,
}

impl<'fd> Timeline<'fd> {
    pub(super) fn new(stop: BorrowedFd<'fd>, control: PlayControl) -> io::Result<Self> {
        let mut set = WaitSet::new()?;
        set.add_descriptor(stop, Interest::Readable, Ready::Stop)?;
        set.add_descriptor(control.clone(), Interest::Readable, Ready::Command)?;
        Ok(Self {
            set,
            control,
            service: None,
            conductor: None,
            clock: None,
            reading: None,
            pace: None,
            in_step: false,
            inputs: None,
        })
    }

    /// Publishes domain time from now on.
    pub(super) fn publish_time(&mut self, node: &Node) -> Result<(), PlayError> {
        self.clock = Some(ClockSource::new(node)?);
        Ok(())
    }

    /// Conducts a lockstep from now on.
    pub(super) fn conduct(&mut self, node: &Node) -> Result<(), PlayError> {
        let conductor = Conductor::new(node)?;
        let added = conductor.add_to(&mut self.set, Ready::Member);
        added.map_err(WaitError::Io)?;
        self.conductor = Some(conductor);
        Ok(())
    }

    /// Takes commands by a service from now on.
    pub(super) fn serve(&mut self, node: &Node, service: &Name) -> Result<(), PlayError> {
        let service = ControlService::new(node, service, self.control.clone())?;
        let added = service.add_to(&mut self.set, Ready::Call);
        added.map_err(WaitError::Io)?;
        self.service = Some(service);
        Ok(())
    }

    pub(super) const fn control(&self) -> &PlayControl {
        &self.control
    }

    /// The members of the lockstep that left.
    pub(super) fn left(&self) -> impl Iterator<Item = &Name> {
        self.conductor.iter().flat_map(Conductor::left)
    }

    /// Whether a node that uses domain time is not linked yet.
    pub(super) fn lacks_listener(&self) -> bool {
        let listeners = self.clock.as_ref().map(ClockSource::listeners);
        listeners.is_some_and(|(there, open)| open < there)
    }

    /// Waits until this number of members have joined the lockstep.
    pub(super) fn wait_for_members(&mut self, demanded: usize) -> Result<bool, PlayError> {
        self.wait(|it| {
            let members = it.conductor.as_ref().map_or(0, Conductor::members);
            (members >= demanded).then_some(Instant(0))
        })
    }

    /// Waits until a moment, also during a pause.
    pub(super) fn wait_until(&mut self, due: Instant) -> Result<bool, PlayError> {
        self.wait(|_| Some(due))
    }

    /// Waits until messages of this time may be published.
    pub(super) fn wait_for(&mut self, time: u64) -> Result<bool, PlayError> {
        self.wait(|it| {
            // An event may come while a step is in progress: the next step waits until this one is over.
            it.in_step = it.in_step || it.control.begin_step();
            match it.in_step {
                true => Some(Instant(0)),
                false => it.pace.and_then(|pace| pace.due(time)),
            }
        })
    }

    /// Waits until the moment that `due` says, which can change with each event; `None` is later than the next event.
    fn wait(
        &mut self,
        mut due: impl FnMut(&mut Self) -> Option<Instant>,
    ) -> Result<bool, PlayError> {
        loop {
            if self.control.has_ended() {
                return Ok(false);
            }
            let due = due(self);
            let ready = match due {
                Some(due) => self.set.wait_timeout(due.since(sm2_io::clock::now()))?,
                None => Some(self.set.wait()?),
            };
            match ready.map(|it| it.tag) {
                Some(Ready::Stop) => return Ok(false),
                Some(ready) => self.handle(ready)?,
                None if due.is_some_and(|it| it <= sm2_io::clock::now()) => return Ok(true),
                None => {}
            }
        }
    }

    fn handle(&mut self, ready: Ready) -> Result<(), PlayError> {
        match (ready, &mut self.conductor, &mut self.service) {
            (Ready::Member, Some(conductor), _) => conductor.pump(),
            (Ready::Call, _, Some(service)) => {
                service.receive()?;
                self.follow()
            }
            (Ready::Command, ..) => self.follow(),
            _ => Ok(()),
        }
    }

    /// Follows the commands: goes on from the present time at the demanded speed.
    fn follow(&mut self) -> Result<(), PlayError> {
        let rate = self.control.follow();
        if let Some(pace) = &mut self.pace
            && pace.rate() != rate
        {
            let now = sm2_io::clock::now();
            pace.set_rate(now, rate);
            self.show_pace(now)?;
        }
        if let Some(service) = &mut self.service {
            service.reply(rate.is_none());
        }
        Ok(())
    }

    /// Goes on to the time of the next message, which may be published then.
    pub(super) fn advance(&mut self, time: u64) -> Result<bool, PlayError> {
        if self.pace.is_none() {
            let (now, rate) = (sm2_io::clock::now(), self.control.follow());
            self.pace = Some(Pace::new(now, time, rate));
            self.show_pace(now)?;
        }
        let inputs = DomainTime(time);
        if self.inputs == Some(inputs) {
            return self.wait_for(time);
        }
        if !self.step_until(inputs)? || !self.wait_for(time)? {
            return Ok(false);
        }
        self.set_time(inputs)?;
        self.inputs = Some(inputs);
        Ok(true)
    }

    /// Counts a message that was published.
    pub(super) fn published(&mut self, time: u64) {
        self.control.count(time);
        if self.conductor.is_none() {
            self.end_step();
        }
    }

    /// Passes the last messages on to the members of the lockstep.
    pub(super) fn finish(&mut self) -> Result<bool, PlayError> {
        match self.inputs {
            Some(inputs) => self.step(inputs),
            None => Ok(true),
        }
    }

    /// Ends a replay: domain time stands still, and another replay may begin.
    pub(super) fn end(&mut self) -> Result<(), PublishError> {
        let now = sm2_io::clock::now();
        if let Some(pace) = &mut self.pace {
            pace.set_rate(now, None);
        }
        let shown = self.show_pace(now);
        if let Some(service) = &mut self.service {
            service.end();
        }
        (self.pace, self.inputs, self.in_step) = (None, None, false);
        shown
    }

    /// In lockstep, passes the messages that were published on to the members, and makes a step for each time before
    /// `time` when a timer of theirs is due.
    fn step_until(&mut self, time: DomainTime) -> Result<bool, PlayError> {
        if self.conductor.is_none() {
            return Ok(true);
        }
        if let Some(inputs) = self.inputs.take()
            && !self.step(inputs)?
        {
            return Ok(false);
        }
        loop {
            let next = self.conductor.as_ref().and_then(Conductor::next);
            let Some(next) = next.filter(|next| *next < time) else {
                return Ok(true);
            };
            if !self.wait_for(next.0)? {
                return Ok(false);
            }
            self.set_time(next)?;
            if !self.step(next)? {
                return Ok(false);
            }
        }
    }

    /// Makes a step of the lockstep, and waits until it is over.
    fn step(&mut self, time: DomainTime) -> Result<bool, PlayError> {
        let Some(conductor) = &mut self.conductor else {
            return Ok(true);
        };
        conductor.begin(time)?;
        let is_over = self.wait(|it| {
            let is_running = it.conductor.as_ref().is_some_and(Conductor::is_running);
            (!is_running).then_some(Instant(0))
        })?;
        self.end_step();
        Ok(is_over)
    }

    /// Ends a step that a command has demanded.
    fn end_step(&mut self) {
        if std::mem::take(&mut self.in_step)
            && let Some(service) = &mut self.service
        {
            service.step_is_over();
        }
    }

    /// Sets domain time to that of the next messages, if it stands still until then: in lockstep, during a pause and at
    /// the greatest speed.
    fn set_time(&mut self, time: DomainTime) -> Result<(), PublishError> {
        if let Some(pace) = &mut self.pace
            && pace.ns_per_s() == 0
        {
            let now = sm2_io::clock::now();
            pace.reach(now, time.0);
            self.show_pace(now)?;
        }
        match self.conductor {
            Some(_) => self.show(time, 0),
            None => Ok(()),
        }
    }

    /// Publishes domain time as the pace says. In lockstep, each step sets it.
    fn show_pace(&mut self, now: Instant) -> Result<(), PublishError> {
        match (&self.pace, &self.conductor) {
            (Some(pace), None) => self.show(DomainTime(pace.time(now)), pace.ns_per_s()),
            _ => Ok(()),
        }
    }

    /// Publishes domain time, unless it stands still there already.
    fn show(&mut self, time: DomainTime, ns_per_s: u64) -> Result<(), PublishError> {
        let is_shown = self
            .reading
            .is_some_and(|it| (it.time, it.ns_per_s, ns_per_s) == (time, 0, 0));
        if let Some(clock) = &self.clock
            && !is_shown
        {
            self.reading = Some(clock.set(time, ns_per_s)?);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::os::fd::AsFd;

    use sm2_io::Waker;

    use super::super::control::PlayCommand;
    use super::*;

    /// Lets a paused player go on to messages of the times 1, 2, ..., with these commands before each.
    fn after(commands: &[&[PlayCommand]]) -> PlayControl {
        let never = Waker::new().unwrap();
        let control = PlayControl::new(1.0, true).unwrap();
        let mut timeline = Timeline::new(never.as_fd(), control.clone()).unwrap();
        for (time, commands) in (1..).zip(commands) {
            for command in *commands {
                control.send(*command).unwrap();
            }
            assert!(timeline.advance(time).unwrap());
            timeline.published(time);
        }
        control
    }

    /// The second command of two wakes the player again, which has begun the first step by then.
    #[test]
    fn a_step_that_is_demanded_during_a_step_is_not_lost() {
        use PlayCommand::{Rate, Step};
        let control = after(&[&[Step], &[Step, Step]]);
        assert_eq!(control.status().messages, 2);
        assert!(control.begin_step() && !control.begin_step());
        let control = after(&[&[Step], &[Step, Rate(2.0), Step, Step]]);
        assert!(control.begin_step() && control.begin_step() && !control.begin_step());
    }
}
