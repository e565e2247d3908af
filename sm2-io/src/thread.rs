//! Threads of a library in the processes of others, and threads that leave the processor to others.

use std::io;
use std::thread::{Builder, JoinHandle};

use crate::syscall::{scheduling, signals};

/// Starts a thread with all signals blocked, so that the handlers of the program run on the program's own
/// threads. The kernel keeps the first 15 bytes of `name`.
///
/// The thread inherits the scheduling policy, the priority and the affinity of the calling thread.
///
/// # Errors
///
/// Any error of `pthread_create(3)`, such as too many threads or no memory.
pub fn spawn_without_signals<T: Send + 'static>(
    name: String,
    body: impl FnOnce() -> T + Send + 'static,
) -> io::Result<JoinHandle<T>> {
    #[cfg(feature = "fault-injection")]
    let body = crate::fault::inherited(body);
    // A new thread inherits the mask, so no signal reaches it before its first instruction.
    let mask = signals::block_all();
    let thread = Builder::new().name(name).spawn(body);
    signals::set_mask(&mask);
    thread
}

/// Lets the calling thread run only while no thread with another policy wants its processor (`SCHED_IDLE`). A thread
/// that wakes up displaces it at once. Threads that it starts afterwards inherit this.
///
/// # Errors
///
/// Any error of `sched_setscheduler(2)`, such as that of a sandbox that forbids the call.
pub fn run_when_idle() -> io::Result<()> {
    Ok(scheduling::set_idle()?)
}

#[cfg(test)]
mod tests {
    use std::thread;

    use sm2_test_support::Scheduling;

    #[test]
    fn the_policy_is_inherited() {
        let policies = thread::spawn(|| {
            let before = Scheduling::of_this_thread();
            super::run_when_idle().unwrap();
            let own = Scheduling::of_this_thread();
            let child = thread::spawn(Scheduling::of_this_thread).join().unwrap();
            [before, own, child].map(|it| it.policy)
        });
        assert_eq!(policies.join().unwrap(), [0, 5, 5]);
    }
}
