//! Futures, streams and sinks over a real Manager.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use crate::common::{Domain, LANES, SOON, pair};
use futures_util::{SinkExt, StreamExt, poll};
use nix::libc;
use sm2_io::fault::{Call, Fault, Injector};
use sm2_node::asynchronous::{IntoAsync, drive};
use sm2_node::{CallError, Message, PublishError, Publisher, Subscriber};

/// Runs a future on one thread, and fails the test if it takes too long.
fn run<F: Future>(future: F) -> F::Output {
    let runtime = tokio::runtime::Builder::new_current_thread();
    let runtime = { runtime }.enable_all().build().expect("a runtime");
    let done = async { tokio::time::timeout(SOON, future).await };
    runtime.block_on(done).expect("in time")
}

/// A reliable publisher and subscriber with room for one message on each side.
fn narrow<T: Message + ?Sized>(
    domain: &Domain,
    timeout: Duration,
) -> (Publisher<T>, Subscriber<T>) {
    pair(
        domain,
        |node| {
            let builder = node.publisher_builder("narrow").depth(1);
            builder
                .reliable(true)
                .publish_timeout(timeout)
                .declare()
                .expect("granted")
        },
        |node| {
            let builder = node.subscriber_builder("narrow").depth(1);
            let builder = builder.max_borrowed(1).reliable(true);
            builder.declare().expect("granted")
        },
    )
}

/// The task of a handle without a descriptor of its own would miss messages.
#[test]
fn a_handle_has_its_descriptor_or_an_error() {
    let faults = [
        (Call::EpollCreate, 1),
        (Call::EpollCtl, 1),
        (Call::EpollCtl, 2),
        (Call::Dup, 1),
    ];
    let domain = Domain::new();
    let node = domain.node("node");
    let injector = Injector::counting();
    run(async {
        for (call, nth) in faults {
            let subscriber = node.subscriber::<u64>("topic").unwrap();
            let publisher = node.publisher::<u64>("topic").unwrap();
            let server = node.server::<u64, u64>("service").unwrap();
            let client = node.client::<u64, u64>("service").unwrap();
            let _installed = injector.install();
            let fail = || {
                injector.set([Fault {
                    call,
                    nth,
                    times: 1,
                    errno: libc::EMFILE,
                }]);
            };
            fail();
            assert!(subscriber.into_async().is_err(), "{call:?} {nth}");
            fail();
            assert!(publisher.into_async().is_err(), "{call:?} {nth}");
            fail();
            assert!(server.into_async().is_err(), "{call:?} {nth}");
            fail();
            assert!(client.into_async().is_err(), "{call:?} {nth}");
        }
    });
}

#[test]
fn a_stream_has_every_message_in_order() {
    let domain = Domain::new();
    let (publisher, subscriber) = pair(
        &domain,
        // For an unreliable link, a full socket displaces messages.
        |node| {
            let builder = node
                .publisher_builder::<u64>("count")
                .reliable(true)
                .publish_timeout(SOON);
            builder.declare().expect("granted")
        },
        |node| {
            let builder = node.subscriber_builder("count").depth(1_000);
            builder.reliable(true).declare().expect("granted")
        },
    );
    let numbers = run(async {
        let subscriber = subscriber.into_async().expect("watched");
        let publishing = tokio::task::spawn_blocking(move || {
            for number in 0..1_000_u64 {
                publisher.publish(&number).expect("published");
                if number % 100 == 0 {
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
            assert!(publisher.flush_timeout(SOON).expect("flushed"));
            publisher
        });
        let numbers: Vec<u64> = subscriber
            .take(1_000)
            .map(|sample| *sample.expect("received"))
            .collect()
            .await;
        drop(publishing.await.expect("no panic"));
        numbers
    });
    assert!(numbers.into_iter().eq(0..1_000));
}

#[test]
fn a_receive_that_is_cancelled_takes_nothing() {
    let domain = Domain::new();
    let node = domain.node("both");
    let publisher = node.publisher::<u64>("count").expect("granted");
    let builder = node.subscriber_builder::<u64>("count");
    let subscriber = builder.depth(100).declare().expect("granted");
    publisher
        .wait_for_subscribers_timeout(1, SOON)
        .expect("linked");
    run(async {
        let subscriber = subscriber.into_async().expect("watched");
        for number in 0..100_u64 {
            // There is no message: this future is dropped while it waits.
            let early = tokio::time::timeout(Duration::from_micros(10), subscriber.recv());
            assert!(early.await.is_err());
            publisher.publish(&number).expect("published");
            let sample = subscriber.recv().await.expect("received");
            assert_eq!((*sample, sample.lost()), (number, 0));
        }
    });
}

#[test]
fn tasks_share_a_subscriber() {
    let domain = Domain::new();
    let node = domain.node("both");
    let publisher = node.publisher::<u64>("count").expect("granted");
    let builder = node.subscriber_builder::<u64>("count");
    let subscriber = builder.depth(100).declare().expect("granted");
    publisher
        .wait_for_subscribers_timeout(1, SOON)
        .expect("linked");
    let mut all = run(async {
        let subscriber = Arc::new(subscriber.into_async().expect("watched"));
        let tasks: Vec<_> = (0..10)
            .map(|_| {
                let subscriber = Arc::clone(&subscriber);
                tokio::spawn(async move { *subscriber.recv().await.expect("received") })
            })
            .collect();
        tokio::task::yield_now().await;
        for number in 0..10_u64 {
            publisher.publish(&number).expect("published");
        }
        let mut all = Vec::new();
        for task in tasks {
            all.push(task.await.expect("no panic"));
        }
        all
    });
    all.sort_unstable();
    assert!(all.into_iter().eq(0..10));
}

#[test]
fn a_sink_waits_for_a_reliable_subscriber_without_blocking_the_thread() {
    let domain = Domain::new();
    let (publisher, subscriber) = narrow::<[u8]>(&domain, SOON);
    // Messages in cells of the ring, and in slots.
    let len = |number| [10, 128][usize::from(number % 2)];
    run(async {
        let mut publisher = publisher.into_async().expect("watched");
        let mut subscriber = subscriber.into_async().expect("watched");
        // Both run on one thread: if one of them blocked it, both would wait forever.
        let send = async {
            for number in 0..200_u8 {
                publisher
                    .send(vec![number; len(number)])
                    .await
                    .expect("sent");
            }
        };
        let receive = async {
            for number in 0..200_u8 {
                let sample = subscriber.next().await.expect("no end").expect("received");
                assert_eq!(*sample, vec![number; len(number)]);
            }
        };
        tokio::join!(send, receive);
    });
}

//= SM2-QOS-002 test
#[test]
fn a_publication_that_finds_no_room_in_time_says_so() {
    let domain = Domain::new();
    let (publisher, subscriber) = narrow::<u64>(&domain, Duration::from_millis(20));
    run(async {
        let mut publisher = publisher.into_async().expect("watched");
        let mut missed = 0;
        for number in 0..20 {
            missed += publisher.publish(&number).await.expect("published").missed;
        }
        assert!(missed > 0, "nobody takes anything");
        let error = loop {
            if let Err(error) = publisher.send(7).await {
                break error;
            }
        };
        assert!(matches!(error, PublishError::DeadlineExceeded { .. }));
        drop(subscriber);
        drop(publisher.into_inner());
    });
}

#[test]
fn services_are_async_functions() {
    let domain = Domain::new();
    let (asks, answers) = (domain.node("asks"), domain.node("answers"));
    let server = answers.server::<u64, u64>("double").expect("granted");
    let client = asks.client::<u64, u64>("double").expect("granted");
    run(async {
        let server = server.into_async().expect("watched");
        let client = client.into_async().expect("watched");
        let serving = server.serve(8, async |request| {
            tokio::time::sleep(Duration::from_millis(**request % 3)).await;
            match **request {
                13 => Err("unlucky"),
                number => Ok(2 * number),
            }
        });
        let calls = futures_util::future::join_all((0..50).map(|number| {
            let client = &client;
            async move { (number, client.call_timeout(&number, SOON).await) }
        }));
        let answers = tokio::select! {
            ended = serving => panic!("{ended:?}"),
            answers = calls => answers,
        };
        for (number, answer) in answers {
            match (number, answer) {
                (13, Err(CallError::Failed { reason, .. })) => assert_eq!(reason, "unlucky"),
                (_, Ok(reply)) => assert_eq!(*reply, 2 * number),
                (number, other) => panic!("{number}: {other:?}"),
            }
        }
    });
}

//= SM2-SRV-003 test
#[test]
fn a_call_that_is_dropped_is_cancelled() {
    let domain = Domain::new();
    let (asks, answers) = (domain.node("asks"), domain.node("answers"));
    let server = answers.server::<u64, u64>("slow").expect("granted");
    let client = asks.client::<u64, u64>("slow").expect("granted");
    run(async {
        let server = server.into_async().expect("watched");
        let client = client.into_async().expect("watched");
        let request = {
            let call = client.call_timeout(&1, SOON);
            tokio::select! {
                reply = call => panic!("nobody answered: {reply:?}"),
                request = server.recv() => request.expect("received"),
            }
        };
        while !request.is_cancelled() {
            client.get_ref().links();
            tokio::task::yield_now().await;
        }
        let late = client.call_timeout(&2, Duration::from_millis(20)).await;
        assert!(matches!(late, Err(CallError::DeadlineExceeded { .. })));
    });
}

/// A task that waits for its own reply may read the reply of another task.
//= SM2-RNG-012 test
#[test]
fn a_task_is_woken_though_another_one_took_note_of_its_reply() {
    for lane in LANES {
        let domain = Domain::new();
        let (asks, answers) = (
            domain.node_on(lane, "asks"),
            domain.node_on(lane, "answers"),
        );
        let server = answers.server::<u64, u64>("echo").expect("granted");
        let client = asks.client::<u64, u64>("echo").expect("granted");
        run(async {
            let client = client.into_async().expect("watched");
            let mut waiting = pin!(client.call_timeout(&1, SOON));
            let request = loop {
                assert!(poll!(&mut waiting).is_pending());
                if let Some(request) = server.try_recv().expect("received") {
                    break request;
                }
                tokio::task::yield_now().await;
            };
            let mut other = client.get_ref().send_timeout(&2, SOON).expect("sent");
            // Now the task sleeps, and the runtime has no change to report.
            for _ in 0..10 {
                tokio::task::yield_now().await;
                assert!(poll!(&mut waiting).is_pending());
            }
            request.reply(&1).expect("replied");
            assert!(other.try_wait().expect("no reply yet").is_none());
            assert_eq!(*waiting.await.expect("replied"), 1);
        });
    }
}

#[test]
fn a_driven_node_opens_its_links_by_itself() {
    let domain = Domain::new();
    let (talker, listener) = (domain.node("talker"), domain.node("listener"));
    let publisher = talker.publisher::<u64>("count").expect("granted");
    run(async {
        let driver = tokio::spawn(drive(talker.clone()));
        let subscriber = listener.subscriber::<u64>("count").expect("granted");
        let linked = tokio::task::spawn_blocking(move || {
            let linked = subscriber.wait_for_publishers_timeout(1, SOON);
            linked.map(|()| subscriber)
        });
        let _subscriber = linked.await.expect("no panic").expect("linked");
        driver.abort();
    });
    drop(publisher);
}
