//! Ctrl-C, SIGTERM and SIGHUP: they end a wait, and the command ends at its next step.
#![allow(
    clippy::disallowed_types,
    reason = "the signal handlers of signal-hook write these types"
)]

use std::{
    io,
    os::{
        fd::{AsFd, BorrowedFd},
        unix::net::UnixStream,
    },
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ},
    flag,
    low_level::pipe,
};
use sm2_io::is_signal_ignored;

/// The exit status of a program that a signal ended is this much more than the signal.
const STATUS_OF_SIGNALS: i32 = 128;

/// The signal that asks the command to end, and a descriptor that becomes readable when it comes.
///
/// A command checks for the signal between two steps and ends cleanly. A second signal ends the process at
/// once, even if the command is stuck.
#[derive(Debug)]
pub(crate) struct Interrupt {
    signal: Arc<AtomicUsize>,
    /// Whether a signal came before.
    again: Arc<AtomicBool>,
    written_by_handler: UnixStream,
    /// Never read, so that it stays readable after a signal.
    pipe: UnixStream,
}

/// The signal that ended a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stopped(usize);

impl Interrupt {
    /// Catches SIGINT, SIGTERM and SIGHUP from now on, unless the process was started with SIGHUP ignored, as nohup(1)
    /// does. A file that grows beyond its limit gives an error instead of the signal SIGXFSZ. Must be called once per
    /// process only.
    ///
    /// # Errors
    ///
    /// The error of the operating system.
    pub(crate) fn install() -> io::Result<Self> {
        let (pipe, written_by_handler) = UnixStream::pair()?;
        let interrupt = Self {
            signal: Arc::new(AtomicUsize::new(0)),
            again: Arc::new(AtomicBool::new(false)),
            written_by_handler,
            pipe,
        };
        interrupt.add(SIGINT)?;
        interrupt.add(SIGTERM)?;
        if !is_signal_ignored(SIGHUP) {
            interrupt.add(SIGHUP)?;
        }
        // Nobody looks at the flag.
        flag::register(SIGXFSZ, Arc::new(AtomicBool::new(false)))?;
        Ok(interrupt)
    }

    /// Lets one more signal end the command.
    ///
    /// # Errors
    ///
    /// The error of the operating system.
    pub(crate) fn add(&self, number: i32) -> io::Result<()> {
        // The handlers run in this order, so the number is stored before the pipe wakes the command.
        let status = STATUS_OF_SIGNALS + number;
        flag::register_conditional_shutdown(number, status, Arc::clone(&self.again))?;
        flag::register(number, Arc::clone(&self.again))?;
        flag::register_usize(number, Arc::clone(&self.signal), number as usize)?;
        pipe::register(number, self.written_by_handler.try_clone()?)?;
        Ok(())
    }

    /// The signal that came, if one did.
    pub(crate) fn signal(&self) -> Option<Stopped> {
        match self.signal.load(Ordering::Acquire) {
            0 => None,
            number => Some(Stopped(number)),
        }
    }
}

impl AsFd for Interrupt {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.pipe.as_fd()
    }
}

impl Stopped {
    /// The exit status of a program that this signal ended, as shells expect it: 129, 130 or 143.
    pub(crate) fn status(self) -> u8 {
        u8::try_from(STATUS_OF_SIGNALS as usize + self.0).unwrap_or(u8::MAX)
    }
}
