//! Measures the cost of a message for the two processes that exchange it: `message_cost [BYTES [LANE
//! [AT_A_TIME]]]`.
//!
//! Publisher and subscriber are nodes of one thread, so no thread sleeps or waits for another core. The
//! result is the time that the library and the kernel need. Prints nanoseconds per message, the median of
//! nine rounds, for both lanes. With `AT_A_TIME`, 1 or 32, it measures only that case, so that `valgrind
//! --tool=callgrind` can attribute the instructions.

#[path = "common/cost.rs"]
mod cost;

use std::time::Instant;

use cost::{Domain, median};
use sm2_node::{Publisher, Subscriber};

const ROUNDS: usize = 9;
const MESSAGES: usize = 32_000;
/// How many messages are published before they are received.
const BATCH: usize = 32;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let bytes = cost::bytes()?;
    let domain = Domain::new()?;
    println!("{bytes} bytes, ns per message: publish, receive and release; the same, 32 at a time");
    let lanes = [("ring", true), ("socket", false)];
    let wanted = std::env::args().nth(2);
    let at_a_time = std::env::args().nth(3).map(|it| it.parse()).transpose()?;
    let is_wanted = |lane: &str| wanted.as_ref().is_none_or(|it| it == lane);
    for (lane, ring) in lanes.into_iter().filter(|it| is_wanted(it.0)) {
        let node = |name: &str| domain.node(name).ring_lane(ring).connect();
        let (talker, listener) = (node("talker")?, node("listener")?);
        let publisher = talker.publisher::<[u8]>("topic")?;
        let subscriber = listener.subscriber_builder::<[u8]>("topic");
        let subscriber = subscriber.depth(64).max_borrowed(32).declare()?;
        while publisher.links().iter().all(|it| !it.open) {
            listener.spin_some()?;
        }
        print!("{lane:<8}");
        for at_a_time in at_a_time.map_or(vec![1, BATCH], |it| vec![it]) {
            let (publish, receive) = cost(&publisher, &subscriber, &vec![1; bytes], at_a_time)?;
            print!(" {publish:>8.0} {receive:>8.0}");
        }
        println!();
    }
    Ok(())
}

fn cost(
    publisher: &Publisher<[u8]>,
    subscriber: &Subscriber<[u8]>,
    message: &[u8],
    at_a_time: usize,
) -> Result<(f64, f64), Box<dyn std::error::Error>> {
    let (mut publish, mut receive) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        let (mut published, mut received) = (0.0, 0.0);
        for _ in 0..MESSAGES / BATCH {
            let start = Instant::now();
            if at_a_time == 1 {
                for _ in 0..BATCH {
                    publisher.publish(message)?;
                }
            } else {
                publisher.publish_all([message; BATCH])?;
            }
            let middle = Instant::now();
            let mut missing = BATCH;
            while missing > 0 {
                missing -= match at_a_time {
                    1 => usize::from(subscriber.try_recv()?.is_some()),
                    _ => subscriber.try_recv_each(BATCH, |it| drop(it))?,
                };
            }
            published += (middle - start).as_secs_f64();
            received += middle.elapsed().as_secs_f64();
        }
        publish.push(published * 1e9 / MESSAGES as f64);
        receive.push(received * 1e9 / MESSAGES as f64);
    }
    Ok((median(publish), median(receive)))
}
