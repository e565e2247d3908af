//! The conductor of a lockstep.

use alloc::collections::{BTreeMap, VecDeque};

use super::{Done, Turn};
use crate::limits::{LOCKSTEP_MEMBERS_MAX, LOCKSTEP_ROUNDS_MAX};
use crate::machine::debug_assert_drained;
use crate::{Error, Instant, Machine, Name, clock::DomainTime};

/// Begins steps, and sends turns to the members.
///
/// Its driver serves the service `lockstep`, and passes each call to the machine.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Conductor {
    members: BTreeMap<Name, State>,
    /// The step that was begun last; 0 before the first one.
    step: u64,
    round: u64,
    time: DomainTime,
    is_running: bool,
    /// The sum of `taken` in the present round.
    taken: u64,
    end: Option<TooManyRounds>,
    outputs: VecDeque<Output>,
}

/// The state of a member. Only a member that works has no call waiting.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum State {
    /// It has joined, and gets its first turn in the next step.
    Joined,
    /// It has finished its turn.
    Waiting { next: Option<DomainTime> },
    /// It has a turn.
    Working,
}

/// An event.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// A member calls.
    Called(Name, Done),
    /// The link to a node has ended, or its call is no longer there.
    Left(Name),
    /// The owner has published the inputs of the next step, which has this time.
    Step(DomainTime),
}

/// Work for the driver.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Reply to the waiting call of this member.
    Turn(Name, Turn),
    /// Answer the call that was fed last as failed: the member has left.
    Refuse(Name, Refused),
    /// Drop the waiting call of this member, because a newer one takes its place.
    Superseded(Name),
    /// The step is over: the next one can begin.
    StepEnded,
}

/// The reason why a call is answered as failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Refused {
    /// The call is not about the member's turn.
    #[error("step {step}, round {round} is not the turn of this member")]
    OtherTurn {
        /// The step of the call.
        step: u64,
        /// The round of the call.
        round: u64,
    },
    /// There are too many members.
    #[error("a lockstep has at most {LOCKSTEP_MEMBERS_MAX} members")]
    Members,
}

/// The end of a conductor: the members publish messages to each other without end at one time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
#[error(
    "step {step} has not ended after {LOCKSTEP_ROUNDS_MAX} rounds: its members answer each other without end"
)]
pub struct TooManyRounds {
    /// The number of the step.
    pub step: u64,
}

/// A mistake of the owner; nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Misuse {
    /// A step is running.
    #[error("step {step} is not over")]
    Running {
        /// The number of the step that runs.
        step: u64,
    },
    /// The time of the step is earlier than that of the step before.
    #[error("the time of a step is not earlier than that of the step before")]
    Back,
}

impl Conductor {
    /// A conductor without members.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The number of members.
    #[must_use]
    pub fn members(&self) -> usize {
        self.members.len()
    }

    /// The names of the members that have not finished their turn.
    pub fn working(&self) -> impl Iterator<Item = &Name> {
        let working = self.members.iter();
        working.filter_map(|(name, state)| (*state == State::Working).then_some(name))
    }

    /// Whether a step is running.
    #[must_use]
    pub const fn is_running(&self) -> bool {
        self.is_running
    }

    /// The time when the first timer of a member is due. The next step has no later time.
    //= SM2-LCK-002
    #[must_use]
    pub fn next(&self) -> Option<DomainTime> {
        let times = self.members.values().filter_map(|it| match it {
            State::Waiting { next } => *next,
            State::Joined | State::Working => None,
        });
        times.min().map(|time| time.max(self.time))
    }

    //= SM2-LCK-002
    fn begin(&mut self, now: Instant, time: DomainTime) -> Result<(), Misuse> {
        if self.is_running {
            return Err(Misuse::Running { step: self.step });
        }
        if time < self.time {
            return Err(Misuse::Back);
        }
        self.step += 1;
        self.round = 0;
        self.time = time;
        self.is_running = true;
        for state in self.members.values_mut() {
            if *state == State::Joined {
                *state = State::Waiting { next: None };
            }
        }
        self.send_turns(now);
        Ok(())
    }

    /// Sends the present round to all members that wait. The step is over if there is none.
    //= SM2-LCK-004
    fn send_turns(&mut self, now: Instant) {
        self.taken = 0;
        let mut sent = false;
        for (name, state) in &mut self.members {
            if let State::Waiting { .. } = state {
                *state = State::Working;
                sent = true;
                let turn = Turn {
                    step: self.step,
                    round: self.round,
                    time: self.time,
                    cut: now,
                };
                self.outputs.push_back(Output::Turn(name.clone(), turn));
            }
        }
        if !sent {
            self.end_step();
        }
    }

    fn end_step(&mut self) {
        self.is_running = false;
        self.outputs.push_back(Output::StepEnded);
    }

    fn called(&mut self, now: Instant, name: Name, done: Done) {
        let state = self.members.get(&name).copied();
        if done.is_join() {
            match state {
                Some(State::Joined | State::Waiting { .. }) => {
                    self.outputs.push_back(Output::Superseded(name.clone()));
                }
                None if self.members.len() == LOCKSTEP_MEMBERS_MAX => {
                    //= SM2-LCK-010
                    self.outputs
                        .push_back(Output::Refuse(name, Refused::Members));
                    return;
                }
                Some(State::Working) | None => {}
            }
            self.members.insert(name, State::Joined);
        } else if state == Some(State::Working)
            && (done.step, done.round) == (self.step, self.round)
        {
            self.taken = self.taken.saturating_add(done.taken);
            self.members
                .insert(name, State::Waiting { next: done.next });
        } else {
            //= SM2-LCK-007
            let (step, round) = (done.step, done.round);
            if matches!(state, Some(State::Joined | State::Waiting { .. })) {
                self.outputs.push_back(Output::Superseded(name.clone()));
            }
            self.members.remove(&name);
            self.outputs
                .push_back(Output::Refuse(name, Refused::OtherTurn { step, round }));
        }
        self.end_round(now);
    }

    /// Goes on if no member has a turn.
    //= SM2-LCK-003
    fn end_round(&mut self, now: Instant) {
        if !self.is_running || self.working().next().is_some() {
            return;
        }
        if self.taken == 0 {
            self.end_step();
        } else if self.round + 1 == LOCKSTEP_ROUNDS_MAX {
            //= SM2-LCK-009
            self.end = Some(TooManyRounds { step: self.step });
        } else {
            self.round += 1;
            self.send_turns(now);
        }
    }
}

impl Machine for Conductor {
    type Input<'a> = Input;
    type Output = Output;
    type End = TooManyRounds;
    type Misuse = Misuse;

    /// Feeds one input. `now` becomes the cut of the turns that it causes, so the driver reads the clock after
    /// everything that the input reports.
    fn handle(&mut self, now: Instant, input: Input) -> Result<(), Error<TooManyRounds, Misuse>> {
        if let Some(end) = self.end {
            return Err(Error::Ended(end));
        }
        debug_assert_drained(&self.outputs);
        match input {
            Input::Step(time) => self.begin(now, time)?,
            Input::Called(name, done) => self.called(now, name, done),
            Input::Left(name) => {
                self.members.remove(&name);
                self.end_round(now);
            }
        }
        self.end.map_or(Ok(()), |end| Err(Error::Ended(end)))
    }

    fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// A conductor waits for its members without a limit.
    fn deadline(&self) -> Option<Instant> {
        None
    }
}
