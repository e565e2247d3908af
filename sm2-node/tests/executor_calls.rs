//! Callbacks that call services of their own executor, and the names of callbacks in errors.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::thread;
use std::time::Duration;

use crate::common::SOON;
use crate::common::fixture::Fixture;
use sm2_node::executor::ExecutorError;
use sm2_node::{Call, CallError, Client, Executor, Node, Timer};

/// A client of `inner` on `node`, which is linked.
fn inner_client(node: &Node) -> Client<u64, u64> {
    let client = node.client::<u64, u64>("inner").unwrap();
    client.wait_for_servers_timeout(1, SOON).unwrap();
    client
}

/// `outer` asks `inner`, which is in the same executor: in the same group or in another one.
fn ask_inner(
    it: &Fixture,
    threads: usize,
    same_group: bool,
    nodes: usize,
) -> Result<u64, CallError> {
    let node = it.peer("robot");
    let other = (nodes == 2).then(|| it.peer("other"));
    let inner = node.server::<u64, u64>("inner").unwrap();
    let client = inner_client(other.as_ref().unwrap_or(&node));
    let (requests, result) = (Mutex::new(Vec::new()), Mutex::new(None));
    let (requests, result, shutdown) = (&requests, &result, &it.shutdown);
    let mut executor = Executor::new().unwrap();
    executor.end_with(shutdown).unwrap();
    let (one, two) = (executor.group(()), executor.group(()));
    let serve_inner = if same_group { &one } else { &two };
    serve_inner.on_request(inner, move |(), request| {
        let request = request?;
        let twice = *request * 2;
        requests.lock().unwrap().push(*request);
        Ok(request.reply(&twice)?)
    });
    let adder = one.clone();
    one.on_tick(Timer::once(Duration::ZERO), move |(), _| {
        let reply = client.call_timeout(&21, SOON).map(|it| *it);
        *result.lock().unwrap() = Some(reply);
        // A second call, whose reply is not waited for here, shows what the server got.
        adder.on_reply(client.send(&4)?, move |(), reply| {
            assert_eq!(*reply?, 8);
            shutdown.request();
            Ok(())
        });
        Ok(())
    });
    executor.run_threads(threads).unwrap();
    let result = result.lock().unwrap().take().unwrap();
    let wanted: &[u64] = if result.is_ok() { &[21, 4] } else { &[4] };
    assert_eq!(*requests.lock().unwrap(), wanted);
    result
}

/// Only one thread runs callbacks, or the callback's group has the server.
#[test]
fn a_call_of_a_service_of_the_own_executor_fails_at_once() {
    Fixture::each(|it| {
        for (threads, same_group, nodes) in [(1, true, 1), (1, false, 2), (3, true, 2)] {
            let it = it.again();
            let error = ask_inner(&it, threads, same_group, nodes).unwrap_err();
            assert!(matches!(error, CallError::OwnExecutor { .. }), "{error:?}");
            let text = error.to_string();
            assert!(
                text.starts_with("inner is served by the executor"),
                "{text}"
            );
        }
    });
}

#[test]
fn another_thread_serves_a_call_of_another_group() {
    Fixture::each(|it| assert_eq!(ask_inner(it, 3, false, 1).unwrap(), 42));
}

#[test]
fn another_executor_serves_a_call() {
    Fixture::each(|it| {
        let node = it.peer("robot");
        let server = node.server::<u64, u64>("inner").unwrap();
        let client = inner_client(&node);
        let mut other = Executor::new().unwrap();
        other.end_with(&it.shutdown).unwrap();
        other.group(()).on_request(server, |(), request| {
            let request = request?;
            let twice = *request * 2;
            Ok(request.reply(&twice)?)
        });
        let mut executor = Executor::new().unwrap();
        executor.end_with(&it.shutdown).unwrap();
        let group = executor.group(0);
        group.on_tick(Timer::once(Duration::ZERO), |result, _| {
            *result = *client.call_timeout(&21, SOON)?;
            it.shutdown.request();
            Ok(())
        });
        thread::scope(|scope| {
            scope.spawn(|| other.run().unwrap());
            let ended = executor.run();
            it.shutdown.request();
            ended.unwrap();
        });
        assert_eq!(group.with(|result| *result), 42);
    });
}

/// A server may answer from another thread, so a callback may wait for a call that an earlier one has sent.
#[test]
fn a_callback_waits_for_a_call_that_was_taken_before() {
    Fixture::each(|it| {
        let node = it.peer("robot");
        let server = node.server::<u64, u64>("inner").unwrap();
        let client = inner_client(&node);
        let (sender, requests) = channel();
        let (waits, waiting) = channel();
        let has_taken = AtomicBool::new(false);
        let mut executor = Executor::new().unwrap();
        executor.end_with(&it.shutdown).unwrap();
        let group = executor.group(None::<Call<u64>>);
        group.on_request(server, |_, request| {
            sender.send(request?)?;
            has_taken.store(true, Ordering::Release);
            Ok(())
        });
        let mut is_sent = false;
        let (has_taken, client) = (&has_taken, &client);
        group.on_tick(Timer::every(Duration::from_millis(1)), move |call, _| {
            if !std::mem::replace(&mut is_sent, true) {
                *call = Some(client.send_timeout(&21, SOON)?);
            }
            if has_taken.load(Ordering::Acquire)
                && let Some(pending) = call.take()
            {
                waits.send(())?;
                assert_eq!(*pending.wait()?, 42);
                it.shutdown.request();
            }
            Ok(())
        });
        thread::scope(|scope| {
            scope.spawn(move || {
                let request = requests.recv_timeout(SOON).unwrap();
                waiting.recv_timeout(SOON).unwrap();
                let twice = *request * 2;
                request.reply(&twice).unwrap();
            });
            let ended = executor.run();
            it.shutdown.request();
            ended.unwrap();
        });
    });
}

/// The error of a callback names its subscriber, its service, or its events.
#[test]
fn an_error_names_the_source_of_its_callback() {
    Fixture::each(|it| {
        let (node, peer) = (it.peer("robot"), it.peer("peer"));
        let failure = |add: &dyn Fn(&Executor<'static>)| {
            let mut executor = Executor::new().unwrap();
            executor.end_with(&it.shutdown).unwrap();
            add(&executor);
            // For a test that would wait for ever.
            let group = executor.group(());
            group.on_tick(Timer::once(5 * SOON), |(), _| Err("it hangs".into()));
            let error = executor.run().unwrap_err();
            let ExecutorError::Callback { origin, .. } = &error else {
                panic!("{error:?}");
            };
            assert_eq!(origin.place().file(), file!());
            origin.source().to_string()
        };
        let publisher = peer
            .publisher_builder::<u64>("scan")
            .latched(1)
            .declare()
            .unwrap();
        publisher.publish(&1).unwrap();
        let text = failure(&|executor| {
            let scans = node.subscriber::<u64>("scan").unwrap();
            executor
                .group(())
                .on_message(scans, |(), _| Err("no".into()));
        });
        assert_eq!(text, "subscriber scan");
        let (speeds, listener) = (
            node.publisher::<u64>("speed").unwrap(),
            peer.subscriber::<u64>("speed").unwrap(),
        );
        let text = failure(&|executor| {
            executor
                .group(())
                .on_event(speeds.events(), |(), _| Err("no".into()));
        });
        drop(listener);
        assert_eq!(text, "the events of publisher speed");
        let client = peer.client::<u64, u64>("double").unwrap();
        let text = failure(&|executor| {
            let server = node.server::<u64, u64>("double").unwrap();
            client.wait_for_servers_timeout(1, SOON).unwrap();
            std::mem::forget(client.send(&1).unwrap());
            executor
                .group(())
                .on_request(server, |(), _| Err("no".into()));
        });
        assert_eq!(text, "server double");
        let server = peer.server::<u64, u64>("triple").unwrap();
        let text = failure(&|executor| {
            let client = node.client::<u64, u64>("triple").unwrap();
            client.wait_for_servers_timeout(1, SOON).unwrap();
            let call = client.send(&1).unwrap();
            server
                .recv_timeout(SOON)
                .unwrap()
                .unwrap()
                .reply(&3)
                .unwrap();
            executor.group(()).on_reply(call, |(), _| Err("no".into()));
        });
        assert_eq!(text, "a call of triple");
    });
}
