//! Commands for a player.

use std::fmt;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::str::FromStr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};
use sm2_io::Waker;

/// A command for a player.
///
/// Its text, which [`Player::serve`](crate::Player::serve) takes, is `pause`, `resume`, `step`, or `rate` and a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlayCommand {
    /// Publish nothing from now on. Domain time stands still.
    Pause,
    /// Go on at the rate before the pause. The messages after the pause keep their distances in time.
    Resume,
    /// Publish the next message, and stay paused. In lockstep, make the next step: publish all messages of the next
    /// time, and let the members handle their inputs.
    Step,
    /// Go on at this speed: see [`PlayOptions::rate`](crate::PlayOptions::rate). A pause goes on.
    Rate(f64),
}

impl fmt::Display for PlayCommand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Pause => f.write_str("pause"),
            Self::Resume => f.write_str("resume"),
            Self::Step => f.write_str("step"),
            Self::Rate(rate) => write!(f, "rate {rate}"),
        }
    }
}

impl FromStr for PlayCommand {
    type Err = PlayCommandError;

    fn from_str(text: &str) -> Result<Self, PlayCommandError> {
        match text {
            "pause" => Ok(Self::Pause),
            "resume" => Ok(Self::Resume),
            "step" => Ok(Self::Step),
            _ => {
                let rate = text.strip_prefix("rate ").and_then(|it| it.parse().ok());
                rate.map(Self::Rate).ok_or(PlayCommandError::Unknown)
            }
        }
    }
}

/// Why a player does not follow a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlayCommandError {
    /// The text is not a command.
    #[error("give pause, resume, step, or a rate such as `rate 2`")]
    Unknown,
    /// The rate is negative or not finite.
    #[error("give a rate of 0 or more, such as 2 or 0.5")]
    Rate,
    /// [`PlayCommand::Step`] is for a player that is paused.
    #[error("the replay is not paused: pause it before a step")]
    NotPaused,
}

/// The state of a player.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlayStatus {
    /// Whether the player is paused.
    pub paused: bool,
    /// The speed, also while the player is paused: see [`PlayOptions::rate`](crate::PlayOptions::rate).
    pub rate: f64,
    /// The number of messages that were published.
    pub messages: u64,
    /// The `log_time` of the message that was published last, in nanoseconds of the wall clock.
    pub time_ns: Option<u64>,
}

/// Controls a player from any thread ([`Player::control`](crate::Player::control)). Clones control the same player.
#[derive(Clone, Debug)]
pub struct PlayControl(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    state: Mutex<State>,
    /// Ends the player's wait after each change by others.
    waker: Waker,
}

#[derive(Debug)]
struct State {
    status: PlayStatus,
    /// The steps that are demanded and have not begun.
    steps: u64,
    ended: bool,
}

impl PlayControl {
    pub(super) fn new(rate: f64, paused: bool) -> io::Result<Self> {
        let status = PlayStatus {
            paused,
            rate,
            messages: 0,
            time_ns: None,
        };
        let state = State {
            status,
            steps: 0,
            ended: false,
        };
        Ok(Self(Arc::new(Shared {
            state: Mutex::new(state),
            waker: Waker::new()?,
        })))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        let state = self.0.state.lock();
        state.unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives a command to the player, which follows it before its next message. A message that the player is publishing
    /// at this moment is published before a pause.
    ///
    /// # Errors
    ///
    /// [`PlayCommandError::NotPaused`], [`PlayCommandError::Rate`].
    pub fn send(&self, command: PlayCommand) -> Result<(), PlayCommandError> {
        let mut state = self.state();
        match command {
            PlayCommand::Pause => state.status.paused = true,
            PlayCommand::Resume => {
                state.status.paused = false;
                state.steps = 0;
            }
            PlayCommand::Step if !state.status.paused => return Err(PlayCommandError::NotPaused),
            PlayCommand::Step => state.steps += 1,
            PlayCommand::Rate(rate) if rate.is_finite() && rate >= 0.0 => state.status.rate = rate,
            PlayCommand::Rate(_) => return Err(PlayCommandError::Rate),
        }
        drop(state);
        self.0.waker.wake();
        Ok(())
    }

    /// Ends [`Player::play`](crate::Player::play), now and later.
    pub fn end(&self) {
        self.state().ended = true;
        self.0.waker.wake();
    }

    /// Whether [`end`](Self::end) was called.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.state().ended
    }

    /// The state that the player has, or will have as soon as it has followed all commands.
    #[must_use]
    pub fn status(&self) -> PlayStatus {
        self.state().status
    }

    /// The demanded speed; `None` during a pause. The descriptor is not readable until the next change.
    pub(super) fn follow(&self) -> Option<f64> {
        // First, so that a change after it makes the descriptor readable again.
        self.0.waker.drain();
        self.rate()
    }

    /// The demanded speed; `None` during a pause.
    pub(super) fn rate(&self) -> Option<f64> {
        let status = self.status();
        (!status.paused).then_some(status.rate)
    }

    /// Begins a step, if one is demanded.
    pub(super) fn begin_step(&self) -> bool {
        let mut state = self.state();
        let begins = state.steps > 0;
        state.steps -= u64::from(begins);
        begins
    }

    /// Counts a message that was published.
    pub(super) fn count(&self, time_ns: u64) {
        let status = &mut self.state().status;
        status.messages += 1;
        status.time_ns = Some(time_ns);
    }
}

/// Readable after a change by others.
impl AsFd for PlayControl {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.waker.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_read_as_it_is_written() {
        let commands = [
            PlayCommand::Pause,
            PlayCommand::Resume,
            PlayCommand::Step,
            PlayCommand::Rate(0.5),
        ];
        for command in commands {
            assert_eq!(command.to_string().parse(), Ok(command));
        }
        for text in ["", "Pause", "pause ", "rate", "rate x", "rate 1 2"] {
            let read = text.parse::<PlayCommand>();
            assert_eq!(read, Err(PlayCommandError::Unknown), "{text:?}");
        }
    }

    #[test]
    fn a_command_that_is_not_legal_changes_nothing() {
        let control = PlayControl::new(2.0, false).unwrap();
        for rate in [-1.0, f64::NAN, f64::INFINITY] {
            let sent = control.send(PlayCommand::Rate(rate));
            assert_eq!(sent, Err(PlayCommandError::Rate));
        }
        let sent = control.send(PlayCommand::Step);
        assert_eq!(sent, Err(PlayCommandError::NotPaused));
        assert_eq!(control.rate(), Some(2.0));
        assert!(!control.begin_step());
    }

    #[test]
    fn a_step_that_has_not_begun_ends_with_the_pause() {
        let control = PlayControl::new(1.0, true).unwrap();
        for _ in 0..2 {
            control.send(PlayCommand::Step).unwrap();
        }
        assert!(control.begin_step());
        control.send(PlayCommand::Resume).unwrap();
        control.send(PlayCommand::Pause).unwrap();
        assert!(!control.begin_step());
    }
}
