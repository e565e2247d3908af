//! A node in a mio loop: `loop_mio [COUNT [PERIOD_MS]]`.
//!
//! The same program as `loop_epoll`, which explains the descriptors to watch and the calls. The difference is
//! the trigger. mio is edge-triggered: it reports once that a descriptor *became* readable. One report may
//! announce more messages than one iteration takes, or than the node reads from its sockets in one call. The
//! descriptor is therefore registered again after each iteration: if there is still something to do, mio
//! reports it again.
//!
//! ```sh
//! cargo run -p sm2-node --example loop_mio -- 10
//! cargo run -p sm2-node --example talker -- 10
//! ```
//!
//! Ends after COUNT messages with status 0, on Ctrl-C with status 130.

mod common;

use std::io::ErrorKind;
use std::os::fd::{AsFd, AsRawFd};
use std::process::ExitCode;
use std::time::Duration;

use common::Outcome;
use mio::unix::SourceFd;
use mio::{Events, Interest, Poll, Token};
use sm2_node::Node;

const MESSAGES: Token = Token(0);
const TIMER: Token = Token(1);
const INTERRUPT: Token = Token(2);

fn main() -> ExitCode {
    common::run(serve)
}

fn serve() -> Outcome<ExitCode> {
    let mut left = common::argument(1, u64::MAX)?;
    let period_ms = common::argument(2, 100)?;
    let interrupts = common::interrupts()?;
    let timer = common::every(Duration::from_millis(period_ms))?;

    let node = Node::new("loop-mio")?;
    let topic = node.subscriber_builder::<str>("chatter").depth(1_024);
    let subscriber = topic.declare()?;
    let publisher = node.publisher::<u64>("heartbeat")?;

    let mut poll = Poll::new()?;
    let watched = subscriber.as_fd().as_raw_fd();
    for (number, token) in [
        (watched, MESSAGES),
        (timer.as_fd().as_raw_fd(), TIMER),
        (interrupts.as_raw_fd(), INTERRUPT),
    ] {
        let registry = poll.registry();
        registry.register(&mut SourceFd(&number), token, Interest::READABLE)?;
    }

    let mut beat = 0;
    let mut events = Events::with_capacity(8);
    while left > 0 {
        match poll.poll(&mut events, None) {
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            result => result?,
        }
        for event in &events {
            match event.token() {
                MESSAGES => {
                    left -= common::print_messages(&subscriber, left)?;
                    let mut source = SourceFd(&watched);
                    let registry = poll.registry();
                    registry.reregister(&mut source, MESSAGES, Interest::READABLE)?;
                }
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
