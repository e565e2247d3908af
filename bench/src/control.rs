//! A process of a run towards its director: lines out, words in.

use std::{
    io::{self, BufRead, Write},
    process,
    sync::{
        Condvar, Mutex, PoisonError,
        atomic::{AtomicU8, Ordering},
    },
    thread,
};

use crate::job::Said;

/// How far the director has let the process go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Stage {
    /// It sets up.
    Prepare,
    /// The word `go` came.
    Go,
    /// The word `stop` came.
    Stop,
    /// Standard input is at its end.
    End,
}

static REACHED: AtomicU8 = AtomicU8::new(Stage::Prepare as u8);
static TURN: Mutex<()> = Mutex::new(());
static CHANGED: Condvar = Condvar::new();

/// Listens to the director, on a thread that sleeps as long as that is silent. `leave`: the
/// process ends at once at the end, whatever it is doing.
///
/// # Errors
///
/// There can be no thread.
pub fn listen(leave: bool) -> io::Result<()> {
    let listener = thread::Builder::new().name("director".into());
    // Its memory counts as the peer's.
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

/// Whether it has come to this.
#[must_use]
pub fn reached(stage: Stage) -> bool {
    REACHED.load(Ordering::Acquire) >= stage as u8
}

/// Sleeps until it has come to this.
pub fn wait_for(stage: Stage) {
    let mut turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    while !reached(stage) {
        turn = CHANGED.wait(turn).unwrap_or_else(PoisonError::into_inner);
    }
}

/// Says it to the director.
///
/// # Errors
///
/// What standard output says: the director is gone.
pub fn say(said: &Said) -> io::Result<()> {
    let mut line = serde_json::to_vec(said)?;
    line.push(b'\n');
    let mut out = io::stdout().lock();
    out.write_all(&line)?;
    out.flush()
}
