//! How executors and their callbacks end: by an error, a panic, a removal, or for good.

use std::io::Read;
use std::os::unix::net::UnixStream;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::thread;
use std::time::{Duration, Instant};

use crate::common::limit::Limit;
use crate::common::wait::LONG;
use crate::common::{SOON, until};
use sm2_node::executor::{CallbackSource, ExecutorError, Failure};
use sm2_node::wait_set::Interest;
use sm2_node::{Executor, Shutdown, Timer};

#[test]
fn an_error_of_a_callback_ends_all_threads_and_another_run_goes_on() {
    let _limit = Limit::new();
    for threads in [1, 3] {
        let shutdown = Shutdown::new().unwrap();
        let mut executor = Executor::new().unwrap();
        executor.end_with(&shutdown).unwrap();
        let group = executor.group(0);
        let line = line!() + 1;
        group.on_tick(Timer::every(Duration::from_millis(1)), |count, _| {
            *count += 1;
            match *count {
                1 => Err(Failure::from("the motor is hot")),
                2 => Ok(()),
                _ => {
                    shutdown.request();
                    Ok(())
                }
            }
        });
        let error = executor.run_threads(threads).unwrap_err();
        let place = format!("{}:{line}", file!());
        let text = format!("the callback of a timer ({place}) failed: the motor is hot");
        assert_eq!(error.to_string(), text);
        let ExecutorError::Callback { origin, .. } = error else {
            panic!("{error:?}");
        };
        assert_eq!(origin.source(), &CallbackSource::Timer);
        executor.run_threads(threads).unwrap();
        assert!(group.with(|count| *count) >= 3);
    }
}

#[test]
fn a_panic_of_a_callback_goes_on_in_the_caller() {
    let _limit = Limit::new();
    for threads in [1, 3] {
        let mut executor = Executor::new().unwrap();
        let (group, idle) = (executor.group(0), executor.group(()));
        idle.on_tick(Timer::every(LONG), |(), _| Ok(()));
        group.on_tick(Timer::once(Duration::ZERO), |count, _| {
            *count += 1;
            panic!("asked to");
        });
        let run = AssertUnwindSafe(|| executor.run_threads(threads));
        let panic = catch_unwind(run).expect_err("it panics");
        assert_eq!(panic.downcast_ref::<&str>(), Some(&"asked to"));
        // The state is as the panic left it, and the group can be used.
        assert_eq!(group.with(|count| *count), 1);
        group.on_tick(Timer::once(Duration::ZERO), |_, _| Err("next".into()));
        assert!(executor.run_threads(threads).is_err());
    }
}

#[test]
fn a_panic_in_another_thread_goes_on_in_the_caller() {
    let _limit = Limit::new();
    let caller = thread::current().id();
    let is_over = AtomicBool::new(false);
    let mut executor = Executor::new().unwrap();
    // The caller is kept busy in one of the groups, so the other thread runs the other one.
    for _ in 0..2 {
        let is_over = &is_over;
        let group = executor.group(());
        group.on_tick(Timer::every(Duration::from_millis(1)), move |(), _| {
            if thread::current().id() != caller {
                is_over.store(true, Ordering::Release);
                panic!("asked to");
            }
            until(|| is_over.load(Ordering::Acquire));
            Ok(())
        });
    }
    let panic = catch_unwind(AssertUnwindSafe(|| executor.run_threads(2)));
    let panic = panic.expect_err("it panics");
    assert_eq!(panic.downcast_ref::<&str>(), Some(&"asked to"));
}

#[test]
fn a_callback_can_remove_itself_and_others() {
    let _limit = Limit::new();
    let shutdown = Shutdown::new().unwrap();
    let dropped = Arc::new(());
    let mut executor = Executor::new().unwrap();
    executor.end_with(&shutdown).unwrap();
    let group = executor.group([0_u32; 2]);
    let (ours, mut theirs) = UnixStream::pair().unwrap();
    let (with, alive) = (group.clone(), Arc::clone(&dropped));
    let always = group.on_ready(ours, Interest::Writable, move |counts, _| {
        let _ = &alive;
        counts[0] += 1;
        Ok(())
    });
    let (sender, own) = channel();
    let ticking = group.on_tick(Timer::every(Duration::from_millis(1)), move |counts, _| {
        if counts[0] == 0 {
            return Ok(());
        }
        counts[1] += 1;
        with.remove(always);
        with.remove(own.try_recv()?);
        // The timer is due again when the callback ends.
        thread::sleep(Duration::from_millis(5));
        Ok(())
    });
    sender.send(ticking).unwrap();
    let (end, counter) = (&shutdown, &dropped);
    let mut ticks = 0;
    group.on_tick(Timer::every(Duration::from_millis(1)), move |_, _| {
        // Its source and its closure are gone.
        ticks += u32::from(Arc::strong_count(counter) == 1);
        if ticks == 3 {
            end.request();
        }
        Ok(())
    });
    executor.run().unwrap();
    let [ready, ticks] = group.with(|counts| *counts);
    assert!(ready >= 1);
    assert_eq!(ticks, 1);
    assert_eq!(
        theirs.read(&mut [0]).unwrap(),
        0,
        "the descriptor is closed"
    );
}

/// The callback of a source that is over is dropped.
#[test]
fn a_callback_that_runs_once_is_dropped_afterwards() {
    let _limit = Limit::new();
    let shutdown = Shutdown::new().unwrap();
    let owned = Arc::new(());
    let mut executor = Executor::new().unwrap();
    executor.end_with(&shutdown).unwrap();
    let group = executor.group(());
    let own = Arc::clone(&owned);
    group.on_tick(Timer::once(Duration::ZERO), move |(), _| {
        let _ = &own;
        Ok(())
    });
    let (end, counter, late) = (&shutdown, &owned, Instant::now() + SOON);
    group.on_tick(Timer::every(Duration::from_millis(1)), move |(), _| {
        if Arc::strong_count(counter) == 1 {
            end.request();
        }
        assert!(Instant::now() < late, "it is not dropped");
        Ok(())
    });
    executor.run().unwrap();
}

/// The values that callbacks own are dropped with the executor, although the callbacks own handles of their groups.
#[test]
fn an_executor_that_is_dropped_drops_its_callbacks() {
    let _limit = Limit::new();
    let executor = Executor::new().unwrap();
    let group = executor.group(());
    let owned = Arc::new(());
    let (clone, own) = (group.clone(), Arc::clone(&owned));
    group.on_tick(Timer::every(LONG), move |(), _| {
        let _ = (&clone, &own);
        Ok(())
    });
    drop((executor, group));
    assert_eq!(Arc::strong_count(&owned), 1);
}

#[test]
fn an_error_of_a_source_that_is_added_ends_the_run() {
    let _limit = Limit::new();
    let mut executor = Executor::new().unwrap();
    let file = std::fs::File::open("Cargo.toml").unwrap();
    let group = executor.group(());
    group.on_ready(file, Interest::Readable, |(), _| Ok(()));
    let error = executor.run().unwrap_err();
    let ExecutorError::Source { origin, .. } = &error else {
        panic!("{error:?}");
    };
    assert_eq!(origin.source(), &CallbackSource::Descriptor);
    assert_eq!(origin.place().file(), file!());
    let text = error.to_string();
    assert!(
        text.starts_with("the executor cannot wait for the callback of a descriptor ("),
        "{text}"
    );
}
