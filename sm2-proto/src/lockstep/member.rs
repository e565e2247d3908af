//! A member of a lockstep.

use super::{Done, Turn};
use crate::{Error, Instant, Machine, clock::DomainTime};

/// A node that takes its inputs in lockstep while there is a conductor.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Member {
    state: State,
    /// The turn before.
    last: Option<Turn>,
    output: Option<MemberOutput>,
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
enum State {
    /// There is no conductor: inputs are handled as they arrive.
    #[default]
    Free,
    /// A call waits for its reply.
    Waiting,
    /// It handles the inputs of a turn.
    Working(Turn),
    Over(IllegalTurn),
}

/// An event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MemberInput {
    /// The service is there.
    Found,
    /// The reply to the call.
    Turn(Turn),
    /// The inputs of the turn are handled.
    Finished {
        /// See [`Done::taken`].
        taken: u64,
        /// See [`Done::next`].
        next: Option<DomainTime>,
    },
    /// The call has failed: the conductor is gone, or has refused it.
    Failed,
}

/// Work for the driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MemberOutput {
    /// Call the service.
    Call(Done),
    /// Handle the inputs of this turn.
    Work(Turn),
}

/// The conductor broke the rules of SM2-LCK-008.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
#[error(
    "step {}, round {} of the lockstep is not a legal turn here (SM2-LCK-008): stop its conductor",
    turn.step, turn.round
)]
pub struct IllegalTurn {
    /// The turn.
    pub turn: Turn,
}

/// A mistake of the owner: the input is not legal in this state, and nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
#[error("this input is not legal in the present state of a member")]
pub struct MemberMisuse;

impl Member {
    /// A member without a conductor.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Whether there is no conductor, so inputs are handled as they arrive.
    #[must_use]
    pub fn is_free(&self) -> bool {
        self.state == State::Free
    }

    /// The turn whose inputs are being handled.
    #[must_use]
    pub const fn turn(&self) -> Option<Turn> {
        match self.state {
            State::Working(turn) => Some(turn),
            _ => None,
        }
    }

    fn call(&mut self, done: Done) {
        self.state = State::Waiting;
        self.output = Some(MemberOutput::Call(done));
    }

    /// Whether the turn may follow the one before, or the join.
    //= SM2-LCK-008
    fn is_legal(&self, turn: &Turn) -> bool {
        let Some(last) = self.last else {
            return turn.step > 0 && turn.round == 0;
        };
        let next_round = turn.step == last.step
            && Some(turn.round) == last.round.checked_add(1)
            && turn.time == last.time;
        let next_step = turn.step > last.step && turn.round == 0 && turn.time >= last.time;
        (next_round || next_step) && turn.cut > last.cut
    }
}

impl Machine for Member {
    type Input<'a> = MemberInput;
    type Output = MemberOutput;
    type End = IllegalTurn;
    type Misuse = MemberMisuse;

    fn handle(
        &mut self,
        _now: Instant,
        input: MemberInput,
    ) -> Result<(), Error<IllegalTurn, MemberMisuse>> {
        match (&self.state, input) {
            (State::Over(end), _) => return Err(Error::Ended(*end)),
            (State::Free, MemberInput::Found) => {
                self.last = None;
                self.call(Done::JOIN);
            }
            (State::Waiting, MemberInput::Turn(turn)) if self.is_legal(&turn) => {
                self.last = Some(turn);
                self.state = State::Working(turn);
                self.output = Some(MemberOutput::Work(turn));
            }
            (State::Waiting, MemberInput::Turn(turn)) => {
                let end = IllegalTurn { turn };
                self.state = State::Over(end);
                return Err(Error::Ended(end));
            }
            (State::Waiting, MemberInput::Failed) => self.state = State::Free,
            //= SM2-LCK-001
            (State::Working(turn), MemberInput::Finished { taken, next }) => {
                let (step, round) = (turn.step, turn.round);
                self.call(Done {
                    step,
                    round,
                    taken,
                    next,
                });
            }
            _ => return Err(Error::Misuse(MemberMisuse)),
        }
        Ok(())
    }

    fn poll(&mut self) -> Option<MemberOutput> {
        self.output.take()
    }

    /// A member waits for its conductor without a limit.
    fn deadline(&self) -> Option<Instant> {
        None
    }
}
