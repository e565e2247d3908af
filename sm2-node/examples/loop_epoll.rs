//! A node in a bare epoll loop: `loop_epoll [COUNT [PERIOD_MS]]`.
//!
//! One thread runs one loop, which waits for three things: a node that subscribes to `chatter` and publishes
//! `heartbeat`, a timer of the program that triggers the heartbeat, and Ctrl-C. Start `sm2 manager`, then run
//! this program beside a talker:
//!
//! ```sh
//! cargo run -p sm2-node --example loop_epoll -- 10
//! cargo run -p sm2-node --example talker -- 10
//! ```
//!
//! - **Descriptors to watch**: the descriptors of all subscribers and servers, and of each client that has pending
//!   calls; for reading, level-triggered. Each descriptor also stands for its whole node: for new links, for
//!   room in a full socket, for the node's own timer. If a node only publishes, watch the node's own
//!   descriptor.
//! - **Calls**: `try_recv`. It drives the whole node first, so no other call is needed. For a node
//!   that only publishes, call `spin_some()`.
//! - **No message is missed**: a subscriber's descriptor stays readable until `try_recv` has returned that
//!   there is no message. That holds even if another call, such as `publish` below, has read the message from
//!   the socket. An iteration may therefore end early and leave messages for the next one.
//!
//! Ends after COUNT messages with status 0, on Ctrl-C with status 130.

mod common;

use std::process::ExitCode;
use std::time::Duration;

use common::Outcome;
use nix::errno::Errno;
use nix::sys::epoll::{Epoll, EpollCreateFlags, EpollEvent, EpollFlags, EpollTimeout};
use sm2_node::Node;

const MESSAGES: u64 = 0;
const TIMER: u64 = 1;
const INTERRUPT: u64 = 2;

fn main() -> ExitCode {
    common::run(serve)
}

fn serve() -> Outcome<ExitCode> {
    let mut left = common::argument(1, u64::MAX)?;
    let period_ms = common::argument(2, 100)?;
    let interrupts = common::interrupts()?;
    let timer = common::every(Duration::from_millis(period_ms))?;

    let node = Node::new("loop-epoll")?;
    let topic = node.subscriber_builder::<str>("chatter").depth(1_024);
    let subscriber = topic.declare()?;
    let publisher = node.publisher::<u64>("heartbeat")?;

    let epoll = Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC)?;
    let readable = |token| EpollEvent::new(EpollFlags::EPOLLIN, token);
    epoll.add(&subscriber, readable(MESSAGES))?;
    epoll.add(&timer, readable(TIMER))?;
    epoll.add(&interrupts, readable(INTERRUPT))?;

    let mut beat = 0;
    let mut events = [EpollEvent::empty(); 8];
    while left > 0 {
        let count = match epoll.wait(&mut events, EpollTimeout::NONE) {
            Err(Errno::EINTR) => continue,
            result => result?,
        };
        for event in &events[..count] {
            match event.data() {
                MESSAGES => left -= common::print_messages(&subscriber, left)?,
                TIMER => {
                    timer.wait()?;
                    beat += 1;
                    publisher.publish(&beat)?;
                }
                _ => return Ok(common::INTERRUPTED.into()),
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}
