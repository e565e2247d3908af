//! What a message costs the two processes that exchange it: `message_cost [BYTES [LANE]]`.
//!
//! Publisher and subscriber are two nodes of this process and of one thread, so nothing ever
//! sleeps or waits for another core: what is left is the work of the library and the kernel.
//! Prints nanoseconds per message, the median of nine rounds, for both lanes.

use std::time::Instant;

use sm2_manager::{Background, Options};
use sm2_node::{Node, Publisher, Subscriber};

const ROUNDS: usize = 9;
const MESSAGES: u32 = 20_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let bytes = match std::env::args().nth(1) {
        Some(argument) => argument.parse()?,
        None => 64,
    };
    let folder = tempfile::tempdir()?;
    let socket = folder.path().join("domain.sock");
    let _manager = Background::start(&socket, Options::default())?;
    println!("{bytes} bytes, ns per message: publish, receive and give back");
    let lanes = [("ring", true), ("socket", false)];
    let wanted = std::env::args().nth(2);
    let is_wanted = |lane: &str| wanted.as_ref().is_none_or(|it| it == lane);
    for (lane, ring) in lanes.into_iter().filter(|it| is_wanted(it.0)) {
        let node = |name: &str| {
            Node::builder(name)
                .socket(&socket)
                .ring_lane(ring)
                .connect()
        };
        let (talker, listener) = (node("talker")?, node("listener")?);
        let publisher = talker.publisher::<[u8]>("topic")?;
        let subscriber = listener.subscriber::<[u8]>("topic")?;
        while publisher.links().iter().all(|it| !it.open) {
            listener.spin_once(None)?;
        }
        let (publish, receive) = cost(&publisher, &subscriber, &vec![1; bytes])?;
        println!("{lane:<8} {publish:>8.0} {receive:>8.0}");
    }
    Ok(())
}

fn cost(
    publisher: &Publisher<[u8]>,
    subscriber: &Subscriber<[u8]>,
    message: &[u8],
) -> Result<(f64, f64), Box<dyn std::error::Error>> {
    let (mut publish, mut receive) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        let (mut published, mut received) = (0.0, 0.0);
        for _ in 0..MESSAGES / 4 {
            let start = Instant::now();
            for _ in 0..4 {
                publisher.publish(message)?;
            }
            let middle = Instant::now();
            for _ in 0..4 {
                drop(subscriber.try_recv()?.ok_or("a message is missing")?);
            }
            published += (middle - start).as_secs_f64();
            received += middle.elapsed().as_secs_f64();
        }
        publish.push(published * 1e9 / f64::from(MESSAGES));
        receive.push(received * 1e9 / f64::from(MESSAGES));
    }
    Ok((median(publish), median(receive)))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
