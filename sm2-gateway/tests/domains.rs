//! Two domains and what goes between them, over QUIC on this machine.

mod common;

use std::time::Duration;

use common::{ALL, Domain, SOON, report, runtime, until};
use sm2_node::CallError;

#[test]
fn a_topic_of_one_domain_is_heard_in_another() {
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let runtime = runtime();
    let left = near.gateway(&runtime, &[(&far, None)], ALL);
    let right = far.gateway(&runtime, &[(&near, Some(left.address()))], ALL);
    let talker = near.node("talker");
    let publisher = talker.publisher::<str>("chatter").unwrap();
    let listener = far.node("listener");
    let subscriber = listener.subscriber::<str>("chatter").unwrap();
    subscriber.wait_for_publishers(1, Some(SOON)).unwrap();
    publisher.wait_for_subscribers(1, Some(SOON)).unwrap();
    let long = "x".repeat(1 << 20);
    for (number, text) in ["hello", "", &long].into_iter().enumerate() {
        publisher.publish(text).unwrap();
        let sample = subscriber.recv_timeout(SOON).unwrap().expect("in time");
        assert!(*sample == *text, "message {number}");
        assert_eq!(sample.publisher().as_str(), "remote/near");
    }
    let peers = report(&runtime, &left).peers;
    assert_eq!(peers[0].messages.sent, 3);
    assert_eq!(peers[0].offered, ["topic chatter"]);
    drop(subscriber);
    // Nobody wants it any more: the gateway does not take it either.
    until("unsubscribed", || {
        publisher.links().iter().all(|it| it.end.is_some())
    });
    runtime.block_on(async { tokio::join!(left.stop(), right.stop()) });
}

#[test]
fn a_service_of_one_domain_is_called_in_another() {
    let (near, far) = (Domain::new("near"), Domain::new("far"));
    let runtime = runtime();
    let left = near.gateway(&runtime, &[(&far, None)], ALL);
    let right = far.gateway(&runtime, &[(&near, Some(left.address()))], ALL);
    let adder = near.node("adder");
    let server = adder.server::<[u64], u64>("sum").unwrap();
    let serving = std::thread::spawn(move || {
        while let Some(request) = server.recv_timeout(SOON).unwrap() {
            match request.len() {
                0 => return,
                1 => request.fail("one is no sum").unwrap(),
                _ => {
                    let sum = request.iter().sum();
                    request.reply(&sum).unwrap();
                }
            }
        }
    });
    let asker = far.node("asker");
    let client = asker.client::<[u64], u64>("sum").unwrap();
    client.wait_for_servers(1, Some(SOON)).unwrap();
    assert_eq!(*client.call(&[1, 2, 3], SOON).unwrap(), 6);
    let many: Vec<u64> = (0..100_000).collect();
    assert_eq!(*client.call(&many, SOON).unwrap(), many.iter().sum::<u64>());
    let error = client.call(&[1], SOON).unwrap_err();
    assert!(matches!(error, CallError::Failed { reason, .. } if reason == "one is no sum"));
    // A lost link is an answer at once.
    runtime.block_on(left.stop());
    until("the server is gone", || {
        matches!(
            client.call(&[1, 2], SOON),
            Err(CallError::NoServer { .. }
                | CallError::ServerGone { .. }
                | CallError::Failed { .. })
        )
    });
    drop(asker);
    let local = near.node("local");
    let client = local.client::<[u64], u64>("sum").unwrap();
    let _ = client.call(&[], Duration::from_millis(10));
    serving.join().unwrap();
    runtime.block_on(right.stop());
}
