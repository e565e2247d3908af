//! The same as pingpong.c and frames.cpp, with the library for Rust: bench ping|pong|out|in COUNT.

use std::error::Error;
use std::time::Duration;

use sm2_node::{Node, Publisher, Subscriber};

const SOON: Duration = Duration::from_secs(60);
const LEN: usize = 10_000_000;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (Some(role), Some(count)) = (arguments.next(), arguments.next()) else {
        return Err("bench ping|pong|out|in COUNT".into());
    };
    let count = count.parse()?;
    let node = Node::new(&role)?;
    match role.as_str() {
        "out" => send(&node, count),
        "in" => receive(&node, count),
        _ => bounce(&node, role == "ping", count),
    }
}

fn bounce(node: &Node, is_ping: bool, rounds: usize) -> Result<(), Box<dyn Error>> {
    let (to, from) = if is_ping {
        ("ping", "pong")
    } else {
        ("pong", "ping")
    };
    let publisher: Publisher<[u8]> = node.publisher(to)?;
    let subscriber: Subscriber<[u8]> = node.subscriber(from)?;
    publisher.wait_for_subscribers_timeout(1, SOON)?;
    subscriber.wait_for_publishers_timeout(1, SOON)?;
    let mut bytes = [0; 64];
    let mut times = Vec::with_capacity(rounds);
    let receive = |bytes: &mut [u8; 64]| -> Result<(), Box<dyn Error>> {
        let sample = subscriber.recv_timeout(SOON)?.ok_or("no message")?;
        bytes.copy_from_slice(&sample);
        Ok(())
    };
    for _ in 0..rounds {
        if is_ping {
            let start = sm2_node::now();
            publisher.publish(&bytes)?;
            receive(&mut bytes)?;
            times.push(sm2_node::now().0 - start.0);
        } else {
            receive(&mut bytes)?;
            publisher.publish(&bytes)?;
        }
    }
    if is_ping {
        times.sort_unstable();
        println!("{}", times[rounds / 2]);
    }
    publisher.flush_timeout(SOON)?;
    Ok(())
}

fn send(node: &Node, frames: usize) -> Result<(), Box<dyn Error>> {
    let publisher = node
        .publisher_builder::<[u8]>("frames")
        .reliable(true)
        .wait_share_percent(100)
        .publish_timeout(SOON)
        .declare()?;
    publisher.wait_for_subscribers_timeout(1, SOON)?;
    // Hidden from the compiler, which would fill memory in place of copying it.
    let frame = std::hint::black_box(vec![7; LEN]);
    for _ in 0..frames {
        let mut loan = publisher.loan_slice(LEN)?;
        loan.copy_from_slice(&frame);
        loan.publish()?;
    }
    publisher.flush_timeout(SOON)?;
    Ok(())
}

fn receive(node: &Node, frames: usize) -> Result<(), Box<dyn Error>> {
    let subscriber = node
        .subscriber_builder::<[u8]>("frames")
        .reliable(true)
        .declare()?;
    // Hidden from the compiler, which would fill memory in place of copying it.
    let frame = std::hint::black_box(vec![7; LEN]);
    let mut start = sm2_node::now();
    for i in 0..frames {
        let sample = subscriber.recv_timeout(SOON)?.ok_or("no frame")?;
        assert!(*sample == *frame, "frame {i} is damaged");
        // The first frames allocate the memory.
        if i == frames / 10 {
            start = sm2_node::now();
        }
    }
    let seconds = (sm2_node::now().0 - start.0) as f64 / 1e9;
    println!("{:.1}", (frames - frames / 10 - 1) as f64 / seconds);
    Ok(())
}
