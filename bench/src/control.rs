//! The connection of a process to its director: standard output and standard input.

use std::{
    io::{self, BufRead, Write},
    process,
    sync::{
        Condvar, Mutex, PoisonError,
        atomic::{AtomicU8, Ordering},
    },
    thread,
};

use crate::job::ProcessEvent;

/// The progress that the director has allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Stage {
    /// The process sets up.
    Prepare,
    /// The word `go` came.
    Go,
    /// The word `stop` came.
    Stop,
    /// Standard input has ended.
    End,
}

static REACHED: AtomicU8 = AtomicU8::new(Stage::Prepare as u8);
static TURN: Mutex<()> = Mutex::new(());
static CHANGED: Condvar = Condvar::new();

/// Starts a thread that reads the director's words. With `leave`, the process exits at once when
/// standard input ends.
///
/// # Errors
///
/// The thread cannot be started.
pub fn listen(leave: bool) -> io::Result<()> {
    let listener = thread::Builder::new().name("director".into());
    // A small stack: its memory is measured as part of the peer's.
    let listener = listener.stack_size(64 << 10);
    listener.spawn(move || {
        for line in io::stdin().lock().lines() {
            match line.as_deref() {
                Ok("go") => reach(Stage::Go),
                Ok("stop") => reach(Stage::Stop),
                _ => break,
            }
        }
        if leave {
            process::exit(0);
        }
        reach(Stage::End);
    })?;
    Ok(())
}

fn reach(stage: Stage) {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    REACHED.store(stage as u8, Ordering::Release);
    CHANGED.notify_all();
}

/// True if the director has allowed this stage or a later one.
#[must_use]
pub fn reached(stage: Stage) -> bool {
    REACHED.load(Ordering::Acquire) >= stage as u8
}

/// Sleeps until the director allows this stage.
pub fn wait_for(stage: Stage) {
    let mut turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    while !reached(stage) {
        turn = CHANGED.wait(turn).unwrap_or_else(PoisonError::into_inner);
    }
}

/// Sends a line to the director.
///
/// # Errors
///
/// Standard output is closed: the director is gone.
pub fn send_event(event: &ProcessEvent) -> io::Result<()> {
    let mut line = serde_json::to_vec(event)?;
    line.push(b'\n');
    let mut out = io::stdout().lock();
    out.write_all(&line)?;
    out.flush()
}
