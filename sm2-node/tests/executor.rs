//! Executors: with one thread and several, with and without the background thread, on both lanes.

mod common;

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use common::threads::{me, sleeps, status};
use common::{DRIVEN, Domain, SOON, meet, until};
use sm2_node::executor::{ExecutorError, Failure};
use sm2_node::wait_set::Interest;
use sm2_node::{Event, Executor, Node, NodeBuilder, Shutdown, Timer, now};

/// Longer than a test may take.
const LONG: Duration = Duration::from_secs(3_600);

struct Fixture {
    domain: Domain,
    shutdown: Shutdown,
    background: bool,
    ring: bool,
    threads: usize,
}

impl Fixture {
    fn each(test: impl Fn(&Self)) {
        for (background, ring) in DRIVEN {
            for threads in [1, 3] {
                test(&Self {
                    domain: Domain::new(),
                    shutdown: Shutdown::new().unwrap(),
                    background,
                    ring,
                    threads,
                });
            }
        }
    }

    fn builder(&self, name: &str) -> NodeBuilder {
        let builder = Node::builder(name).socket(self.domain.socket());
        builder.background(self.background).ring_lane(self.ring)
    }

    fn node(&self, name: &str) -> Node {
        self.builder(name).connect().unwrap()
    }

    /// A node that lives without calls of the test.
    fn peer(&self, name: &str) -> Node {
        self.builder(name).background(true).connect().unwrap()
    }

    fn executor<'a>(&self) -> Executor<'a> {
        let mut executor = Executor::new().unwrap();
        executor.end_with(&self.shutdown).unwrap();
        executor
    }

    /// Runs until the shutdown, which a callback has to request soon.
    fn run(&self, executor: &mut Executor<'_>) {
        // A shutdown of its own for a test that hangs.
        executor
            .group(())
            .on_tick(Timer::once(5 * SOON), |(), _| Err("it hangs".into()));
        executor.run_threads(self.threads).unwrap();
    }
}

/// All kinds of sources, in two groups. The program's only loop is the executor.
#[test]
fn callbacks_run_for_all_kinds_of_sources() {
    Fixture::each(|it| {
        let node = it.node("robot");
        let (ours, mut theirs) = UnixStream::pair().unwrap();
        let topic = node.subscriber::<u64>("topic").unwrap();
        let server = node.server::<u64, u64>("double").unwrap();
        let client = node.client::<u64, u64>("triple").unwrap();
        let events = node.publisher::<u64>("other").unwrap();
        let seen = Mutex::new(Vec::new());
        let see = |what: &'static str| {
            let mut seen = seen.lock().unwrap();
            if !seen.contains(&what) {
                seen.push(what);
            }
            if seen.len() == 6 {
                it.shutdown.request();
            }
        };
        let mut executor = it.executor();
        let (one, other) = (executor.group(0_u64), executor.group(0_u64));
        one.on_message(topic, |sum, sample| {
            *sum += *sample?;
            see("message");
            Ok(())
        });
        other.on_request(server, |count, request| {
            let request = request?;
            *count += 1;
            see("request");
            let twice = *request * 2;
            Ok(request.reply(&twice)?)
        });
        other.on_event(events.events(), |_, event| {
            if matches!(event, Event::Joined { .. }) {
                see("event");
            }
            Ok(())
        });
        one.on_ready(&ours, Interest::Readable, |_, ready| {
            assert!(ready.readable);
            assert_eq!((&ours).read(&mut [0])?, 1);
            see("descriptor");
            Ok(())
        });
        let (adder, see_all) = (other.clone(), &see);
        let mut called = false;
        one.on_tick(Timer::every(Duration::from_millis(1)), move |_, tick| {
            assert!(tick.due <= now());
            see_all("tick");
            if !called && client.links().iter().any(|link| link.open) {
                called = true;
                adder.on_reply(client.send(&7)?, |_, reply| {
                    assert_eq!(*reply?, 21);
                    see_all("reply");
                    Ok(())
                });
            }
            Ok(())
        });
        thread::scope(|scope| {
            scope.spawn(|| {
                let peer = it.peer("peer");
                let triple = peer.server::<u64, u64>("triple").unwrap();
                let _other = peer.subscriber::<u64>("other").unwrap();
                let publisher = peer.publisher::<u64>("topic").unwrap();
                let double = peer.client::<u64, u64>("double").unwrap();
                publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
                publisher.publish(&1).unwrap();
                assert_eq!(*double.call_timeout(&4, SOON).unwrap(), 8);
                let request = triple.recv_timeout(SOON).unwrap().expect("a request");
                let tripled = *request * 3;
                request.reply(&tripled).unwrap();
                theirs.write_all(&[1]).unwrap();
                until(|| it.shutdown.is_requested());
            });
            it.run(&mut executor);
        });
        assert_eq!((one.with(|sum| *sum), other.with(|count| *count)), (1, 1));
    });
}

/// Callbacks of one group never run at the same time, and none of their messages is lost.
#[test]
fn callbacks_of_a_group_exclude_each_other() {
    Fixture::each(|it| {
        const TOPICS: [&str; 3] = ["a", "b", "c"];
        const MESSAGES: u64 = 300;
        let (node, peer) = (it.node("listener"), it.peer("talker"));
        let inside = AtomicBool::new(false);
        let taken = [const { AtomicU64::new(0) }; 3];
        let mut executor = it.executor();
        let group = executor.group(0_u64);
        let mut publishers = Vec::new();
        for (topic, taken) in TOPICS.iter().zip(&taken) {
            let subscriber = node.subscriber::<u64>(topic).unwrap();
            let publisher = peer.publisher::<u64>(topic).unwrap();
            meet(&publisher, &[&subscriber]);
            publishers.push((publisher, taken));
            let inside = &inside;
            group.on_message(subscriber, move |count, sample| {
                assert!(!inside.swap(true, Ordering::AcqRel), "two at a time");
                thread::yield_now();
                *count += 1;
                assert_eq!(*sample?, 1 + taken.fetch_add(1, Ordering::AcqRel));
                assert!(inside.swap(false, Ordering::AcqRel));
                Ok(())
            });
        }
        thread::scope(|scope| {
            scope.spawn(|| {
                thread::scope(|scope| {
                    for (publisher, taken) in &publishers {
                        scope.spawn(|| {
                            for number in 1..=MESSAGES {
                                publisher.publish(&number).unwrap();
                                until(|| taken.load(Ordering::Acquire) == number);
                            }
                        });
                    }
                });
                it.shutdown.request();
            });
            it.run(&mut executor);
        });
        assert_eq!(group.with(|count| *count), MESSAGES * TOPICS.len() as u64);
    });
}

/// Each callback waits for the other one.
#[test]
fn callbacks_of_different_groups_run_at_the_same_time() {
    let shutdown = Shutdown::new().unwrap();
    let mut executor = Executor::new().unwrap();
    executor.end_with(&shutdown).unwrap();
    let (to_first, first) = channel();
    let (to_second, second) = channel();
    let end = &shutdown;
    let one = executor.group(());
    one.on_tick(Timer::once(Duration::ZERO), move |(), _| {
        to_second.send(())?;
        first.recv_timeout(SOON)?;
        end.request();
        Ok(())
    });
    let other = executor.group(());
    other.on_tick(Timer::once(Duration::ZERO), move |(), _| {
        to_first.send(())?;
        Ok(second.recv_timeout(SOON)?)
    });
    executor.run_threads(2).unwrap();
}

/// While a callback runs for long, the other sources of its group are ready: a descriptor, a timer, a subscriber. The
/// thread that waits sleeps all the same, and runs their callbacks afterwards.
#[test]
fn a_busy_group_does_not_keep_the_waiting_thread_awake() {
    let domain = Domain::new();
    let subscriber = domain.node("listener").subscriber::<u64>("topic").unwrap();
    let publisher = domain.node("talker").publisher::<u64>("topic").unwrap();
    meet(&publisher, &[&subscriber]);
    let (ours, mut theirs) = UnixStream::pair().unwrap();
    let shutdown = Shutdown::new().unwrap();
    let (begin, begun) = channel();
    let (end, ended) = channel::<()>();
    let seen = AtomicU64::new(0);
    let see = |what| {
        if seen.fetch_or(what, Ordering::AcqRel) | what == 7 {
            shutdown.request();
        }
    };
    let mut executor = Executor::new().unwrap();
    executor.end_with(&shutdown).unwrap();
    let (group, other) = (executor.group(()), executor.group(()));
    group.on_tick(Timer::once(Duration::ZERO), move |(), _| {
        begin.send(me())?;
        let _ = ended.recv_timeout(SOON);
        Ok(())
    });
    thread::scope(|scope| {
        let running = scope.spawn(|| executor.run_threads(2));
        let busy = begun.recv_timeout(SOON).unwrap();
        group.on_message(subscriber, |(), sample| {
            sample?;
            see(1);
            Ok(())
        });
        group.on_tick(Timer::every(Duration::from_millis(1)), |(), _| {
            see(2);
            Ok(())
        });
        group.on_ready(&ours, Interest::Both, |(), ready| {
            if ready.readable {
                see(4);
            }
            Ok(())
        });
        publisher.publish(&1).unwrap();
        theirs.write_all(&[1]).unwrap();
        // Runs in the thread that is not busy.
        let (tell, told) = channel();
        other.on_tick(Timer::once(Duration::ZERO), move |(), _| {
            Ok(tell.send(me())?)
        });
        let all = [busy, told.recv_timeout(SOON).unwrap()];
        assert_ne!(all[0], all[1]);
        // Many looks in a row: a thread that wakes up is seen awake, or has slept once more.
        let asleep = || {
            let is_asleep = |task| status(task, "State:").starts_with('S');
            all.iter()
                .all(|&task| is_asleep(task))
                .then(|| all.map(sleeps))
        };
        let (mut looks, mut before) = (0, None);
        until(|| {
            let now = asleep();
            let is_same = now.is_some() && now == before;
            looks = if is_same { looks + 1 } else { 0 };
            before = now;
            looks == 200
        });
        assert_eq!(seen.load(Ordering::Acquire), 0, "none of its group runs");
        end.send(()).unwrap();
        running.join().unwrap().unwrap();
    });
    assert_eq!(seen.load(Ordering::Acquire), 7);
}

/// While the callback is about to read, another thread sees the descriptor ready. That must not run the callback again.
#[test]
fn a_descriptor_that_was_read_meanwhile_is_not_ready() {
    let shutdown = Shutdown::new().unwrap();
    let (ours, mut theirs) = UnixStream::pair().unwrap();
    ours.set_nonblocking(true).unwrap();
    let taken = AtomicU64::new(0);
    let mut executor = Executor::new().unwrap();
    executor.end_with(&shutdown).unwrap();
    executor
        .group(())
        .on_ready(&ours, Interest::Readable, |(), _| {
            // The other thread waits by then, and has seen the descriptor.
            thread::sleep(Duration::from_millis(5));
            assert_eq!((&ours).read(&mut [0])?, 1);
            taken.fetch_add(1, Ordering::AcqRel);
            Ok(())
        });
    thread::scope(|scope| {
        scope.spawn(|| {
            for number in 1..=10 {
                theirs.write_all(&[0]).unwrap();
                until(|| taken.load(Ordering::Acquire) == number);
            }
            shutdown.request();
        });
        executor.run_threads(2).unwrap();
    });
}

#[test]
fn an_error_of_a_callback_ends_all_threads_and_another_run_goes_on() {
    for threads in [1, 3] {
        let shutdown = Shutdown::new().unwrap();
        let mut executor = Executor::new().unwrap();
        executor.end_with(&shutdown).unwrap();
        let group = executor.group(0);
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
        assert_eq!(error.to_string(), "a callback failed: the motor is hot");
        assert!(matches!(error, ExecutorError::Callback(_)));
        executor.run_threads(threads).unwrap();
        assert!(group.with(|count| *count) >= 3);
    }
}

#[test]
fn a_panic_of_a_callback_goes_on_in_the_caller() {
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
        counts[1] += 1;
        with.remove(always);
        with.remove(own.recv()?);
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
    let (end, counter) = (&shutdown, &owned);
    group.on_tick(Timer::every(Duration::from_millis(1)), move |(), tick| {
        if Arc::strong_count(counter) == 1 {
            end.request();
        }
        assert!(tick.number < 2_000, "it is not dropped");
        Ok(())
    });
    executor.run().unwrap();
}

/// A server is ready with a request that nobody wants any more, so its callback does not run. Its group goes on.
#[test]
fn a_source_that_is_ready_for_nothing_does_not_hold_up_its_group() {
    Fixture::each(|it| {
        let server = it.node("server").server::<u64, u64>("service").unwrap();
        let client = it.peer("client").client::<u64, u64>("service").unwrap();
        until(|| server.links().iter().any(|link| link.open));
        client.wait_for_servers_timeout(1, SOON).unwrap();
        let mut call = client.send_timeout(&1, Duration::from_millis(1)).unwrap();
        until(|| call.try_wait().is_err());
        let mut executor = it.executor();
        let group = executor.group(0);
        group.on_request(server, |requests, _| {
            *requests += 1;
            Ok(())
        });
        group.on_tick(Timer::every(Duration::from_millis(1)), |_, tick| {
            if tick.number > 3 {
                it.shutdown.request();
            }
            Ok(())
        });
        it.run(&mut executor);
        assert_eq!(group.with(|requests| *requests), 0);
    });
}

/// What the callbacks own is dropped with the executor, although they own handles of their groups.
#[test]
fn an_executor_that_is_dropped_drops_its_callbacks() {
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
    let mut executor = Executor::new().unwrap();
    let file = std::fs::File::open("Cargo.toml").unwrap();
    let group = executor.group(());
    group.on_ready(file, Interest::Readable, |(), _| Ok(()));
    let error = executor.run().unwrap_err();
    assert!(matches!(error, ExecutorError::Io(_)), "{error:?}");
}

#[test]
fn groups_and_executors_can_be_used_by_several_threads() {
    fn is_shared<T: Send + Sync>() {}
    is_shared::<Executor<'static>>();
    is_shared::<sm2_node::executor::Group<'static, Vec<u8>>>();
}
