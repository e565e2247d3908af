//! The threads of this process, as the kernel sees them.

use std::fs;
use std::panic::{self, AssertUnwindSafe};
use std::sync::mpsc;
use std::{process, thread};

use super::SOON;

/// The numbers of the threads of this process that have this name.
pub(crate) fn threads(name: &str) -> Vec<u32> {
    let tasks = fs::read_dir("/proc/self/task").unwrap();
    let number = |task: fs::DirEntry| task.file_name().to_str()?.parse::<u32>().ok();
    let numbers = tasks.filter_map(|task| number(task.unwrap()));
    let has_name = |task: &u32| {
        let found = fs::read_to_string(format!("/proc/self/task/{task}/comm"));
        found.is_ok_and(|it| it.trim_end() == name)
    };
    numbers.filter(has_name).collect()
}

/// The value of a field in the status of a thread.
pub(crate) fn status(task: u32, field: &str) -> String {
    let status = fs::read_to_string(format!("/proc/self/task/{task}/status")).unwrap();
    let mut lines = status.lines();
    let line = lines.find_map(|line| line.strip_prefix(field));
    line.unwrap().trim().to_owned()
}

/// How often a thread has slept.
pub(crate) fn sleeps(task: u32) -> u64 {
    status(task, "voluntary_ctxt_switches:").parse().unwrap()
}

/// The number of the calling thread.
pub(crate) fn me() -> u32 {
    nix::unistd::gettid().as_raw().cast_unsigned()
}

/// Waits until a thread sleeps in the kernel.
pub(crate) fn until_asleep(task: u32) {
    super::until(|| status(task, "State:").starts_with('S'));
}

/// Runs `waits` in a thread of its own, and `then` with the number of that thread once the thread sleeps. Returns the
/// result of `waits`, which must end soon.
pub(crate) fn while_asleep<T: Send>(waits: impl FnOnce() -> T + Send, then: impl FnOnce(u32)) -> T {
    let (tell, told) = mpsc::channel();
    let (finish, finished) = mpsc::channel();
    thread::scope(|scope| {
        scope.spawn(move || {
            tell.send(me()).unwrap();
            let _ = finish.send(waits());
        });
        let task = told.recv().unwrap();
        until_asleep(task);
        let event = panic::catch_unwind(AssertUnwindSafe(|| then(task)));
        let waited = finished.recv_timeout(SOON);
        match (event, waited) {
            (Ok(()), Ok(result)) => result,
            (event, _) => {
                // A panic in this scope would wait for the thread.
                eprintln!("the thread still waits; failure before: {}", event.is_err());
                process::exit(1)
            }
        }
    })
}
