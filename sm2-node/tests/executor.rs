//! Executors: with one thread and several, with and without the background thread, on both lanes.

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::channel;
use std::thread;
use std::time::Duration;

use crate::common::fixture::{Fixture, Peer};
use crate::common::limit::Limit;
use crate::common::threads::{me, sleeps, status};
use crate::common::{Domain, SOON, meet, until};
use sm2_node::wait_set::Interest;
use sm2_node::{Event, Executor, Shutdown, Timer, now};

/// Runs a test for each fixture, with one thread and with three.
fn each(test: impl Fn(&Fixture, usize)) {
    for threads in [1, 3] {
        Fixture::each(|it| test(it, threads));
    }
}

fn executor<'a>(it: &Fixture) -> Executor<'a> {
    let mut executor = Executor::new().unwrap();
    executor.end_with(&it.shutdown).unwrap();
    executor
}

/// Runs until the shutdown, which a callback has to request soon.
fn run(executor: &mut Executor<'_>, threads: usize) {
    // For a test that would wait for ever.
    let group = executor.group(());
    group.on_tick(Timer::once(5 * SOON), |(), _| Err("it hangs".into()));
    executor.run_threads(threads).unwrap();
}

/// All kinds of sources, in two groups. The program's only loop is the executor.
#[test]
fn callbacks_run_for_all_kinds_of_sources() {
    each(|it, threads| {
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
        let mut executor = executor(it);
        let (one, other) = (executor.group(0_u64), executor.group(0_u64));
        one.on_message(topic, |sum, sample| {
            *sum += *sample?;
            see("message");
            Ok(())
        });
        other.on_request(server, |count, request| {
            let (request, _) = (request?, see("request"));
            *count += 1;
            let twice = *request * 2;
            Ok(request.reply(&twice)?)
        });
        other.on_event(events.events(), |_, event| {
            assert!(matches!(event, Event::Joined { .. }), "{event:?}");
            see("event");
            Ok(())
        });
        one.on_ready(&ours, Interest::Readable, |_, _| {
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
                let peer = Peer::new(it);
                peer.topic.publish(&1).unwrap();
                assert_eq!(*peer.double.call_timeout(&4, SOON).unwrap(), 8);
                peer.triple_once();
                theirs.write_all(&[1]).unwrap();
                until(|| it.shutdown.is_requested());
            });
            run(&mut executor, threads);
        });
        assert_eq!((one.with(|sum| *sum), other.with(|count| *count)), (1, 1));
    });
}

/// Callbacks of one group never run at the same time, and none of their messages is lost.
#[test]
fn callbacks_of_a_group_exclude_each_other() {
    each(|it, threads| {
        const TOPICS: [&str; 3] = ["a", "b", "c"];
        const MESSAGES: u64 = if cfg!(feature = "slow") { 300 } else { 50 };
        let (node, peer) = (it.node("listener"), it.peer("talker"));
        let inside = AtomicBool::new(false);
        let taken = [const { AtomicU64::new(0) }; 3];
        let mut executor = executor(it);
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
            run(&mut executor, threads);
        });
        assert_eq!(group.with(|count| *count), MESSAGES * TOPICS.len() as u64);
    });
}

/// Each callback waits for the other one.
#[test]
fn callbacks_of_different_groups_run_at_the_same_time() {
    let _limit = Limit::new();
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

/// Waits until these threads sleep and do not wake up. Looks many times in a row: a thread that wakes up is seen awake,
/// or has slept once more.
fn until_quiet(tasks: [u32; 2]) {
    let (mut looks, mut before) = (0, None);
    until(|| {
        let is_asleep = |&task: &u32| status(task, "State:").starts_with('S');
        let now = tasks.iter().all(is_asleep).then(|| tasks.map(sleeps));
        let is_same = now.is_some() && now == before;
        looks = if is_same { looks + 1 } else { 0 };
        before = now;
        looks == 200
    });
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
        until_quiet(all);
        assert_eq!(seen.load(Ordering::Acquire), 0, "none of its group runs");
        end.send(()).unwrap();
        running.join().unwrap().unwrap();
    });
    assert_eq!(seen.load(Ordering::Acquire), 7);
}

/// While the callback is about to read, another thread sees the descriptor ready. That must not run the callback again.
#[test]
fn a_descriptor_that_was_read_meanwhile_is_not_ready() {
    let _limit = Limit::new();
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

/// Two callbacks of a group read the same socket, which is reported for both at once. The first one takes all, so the
/// other one does not run. A third callback, which is reported with them, ends the executor.
#[test]
fn a_descriptor_that_another_callback_has_read_is_not_ready() {
    let _limit = Limit::new();
    let shutdown = Shutdown::new().unwrap();
    let (ours, mut theirs) = UnixStream::pair().unwrap();
    ours.set_nonblocking(true).unwrap();
    let twin = ours.try_clone().unwrap();
    theirs.write_all(&[0]).unwrap();
    let mut executor = Executor::new().unwrap();
    executor.end_with(&shutdown).unwrap();
    let group = executor.group(0);
    for mut reader in [&ours, &twin] {
        group.on_ready(reader, Interest::Readable, move |taken, _| {
            *taken += reader.read(&mut [0])?;
            Ok(())
        });
    }
    group.on_ready(&theirs, Interest::Writable, |_, _| {
        shutdown.request();
        Ok(())
    });
    executor.run().unwrap();
    assert_eq!(group.with(|taken| *taken), 1);
}

/// A server is ready with a request that nobody wants any more, so its callback does not run. Its group goes on.
#[test]
fn a_source_that_is_ready_for_nothing_does_not_hold_up_its_group() {
    each(|it, threads| {
        let server = it.node("server").server::<u64, u64>("service").unwrap();
        let client = it.peer("client").client::<u64, u64>("service").unwrap();
        until(|| server.links().iter().any(|link| link.open));
        client.wait_for_servers_timeout(1, SOON).unwrap();
        let mut call = client.send_timeout(&1, Duration::from_millis(1)).unwrap();
        until(|| call.try_wait().is_err());
        let mut executor = executor(it);
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
        run(&mut executor, threads);
        assert_eq!(group.with(|requests| *requests), 0);
    });
}

#[test]
fn groups_and_executors_can_be_used_by_several_threads() {
    fn is_shared<T: Send + Sync>() {}
    is_shared::<Executor<'static>>();
    is_shared::<sm2_node::executor::Group<'static, Vec<u8>>>();
}
