//! A node in an `io_uring` loop: `loop_io_uring [COUNT [PERIOD_MS]]`.
//!
//! The same program as `loop_epoll`, which explains the descriptors to watch and the calls. Here, `POLL_ADD`
//! requests ask the kernel to report a readable descriptor. Each request gives one answer, and is submitted
//! again after the iteration: if there is still something to do, the kernel answers at once. (A multishot
//! request would report only *new* data, so an iteration that ends early would leave messages behind.)
//!
//! ```sh
//! cargo run -p sm2-node --example loop_io_uring -- 10
//! cargo run -p sm2-node --example talker -- 10
//! ```
//!
//! Ends after COUNT messages with status 0, on Ctrl-C with status 130. If the kernel offers no `io_uring` to
//! this process, the program says so and ends with status 0.

mod common;

use std::io::{self, ErrorKind, Write, stdout};
use std::os::fd::{AsFd, AsRawFd};
use std::process::ExitCode;
use std::time::Duration;

use common::Outcome;
use io_uring::{IoUring, opcode::PollAdd, types::Fd};
use nix::libc;
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
    let mut ring = match IoUring::new(8) {
        Err(error) if matches!(error.raw_os_error(), Some(libc::ENOSYS | libc::EPERM)) => {
            writeln!(stdout(), "no io_uring here: {error}")?;
            return Ok(ExitCode::SUCCESS);
        }
        result => result?,
    };
    let interrupts = common::interrupts()?;
    let timer = common::every(Duration::from_millis(period_ms))?;

    let node = Node::new("loop-io-uring")?;
    let topic = node.subscriber_builder::<str>("chatter").depth(1_024);
    let subscriber = topic.declare()?;
    let publisher = node.publisher::<u64>("heartbeat")?;

    watch(&mut ring, &subscriber, MESSAGES)?;
    watch(&mut ring, &timer, TIMER)?;
    watch(&mut ring, &interrupts, INTERRUPT)?;

    let mut beat = 0;
    while left > 0 {
        match ring.submit_and_wait(1) {
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            result => result?,
        };
        let answers: Vec<_> = ring.completion().collect();
        for answer in answers {
            if answer.result() < 0 {
                return Err(io::Error::from_raw_os_error(-answer.result()).into());
            }
            match answer.user_data() {
                MESSAGES => {
                    left -= common::print_messages(&subscriber, left)?;
                    watch(&mut ring, &subscriber, MESSAGES)?;
                }
                TIMER => {
                    timer.wait()?;
                    beat += 1;
                    publisher.publish(&beat)?;
                    watch(&mut ring, &timer, TIMER)?;
                }
                _ => return Ok(common::INTERRUPTED.into()),
            }
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Requests one answer when `fd` is readable; the next submission sends the request.
fn watch(ring: &mut IoUring, fd: impl AsFd, token: u64) -> Outcome {
    let events = libc::POLLIN as u32;
    let request = PollAdd::new(Fd(fd.as_fd().as_raw_fd()), events).build();
    // SAFETY: a POLL_ADD refers to a descriptor and to no memory, so the kernel accesses no memory of this
    // process later.
    unsafe { ring.submission().push(&request.user_data(token)) }?;
    Ok(())
}
