//! The publishing process of the demo.

use std::{
    io::{self, Read},
    os::fd::AsFd,
    time::Duration,
};

use sm2_io::clock;
use sm2_node::{Node, Publisher};
use sm2_proto::Instant;

use super::{
    command_line::ProcessArguments,
    part::{DEPTH, Figures, ProcessEvent, START, TOPIC, send_event},
};
use crate::{
    error::DemoError,
    pattern,
    statistics::hundredths,
    waiting::{drive, pause},
};

/// Timeout for the links of all subscribers.
const GATHERING: Duration = Duration::from_secs(20);

/// Timeout for the subscribers to check the last messages.
const RELEASE_TIMEOUT: Duration = Duration::from_secs(5);
/// How often the publisher checks for that.
const LOOK: Duration = Duration::from_millis(10);

/// The interval of reports.
const SECOND: Duration = Duration::from_secs(1);

/// Publishes all messages from the start line on, or until standard input ends. Returns when standard
/// input has ended.
pub(crate) fn run(arguments: &ProcessArguments) -> Result<(), DemoError> {
    let node = Node::builder(&arguments.name)
        .socket(&arguments.socket)
        .connect()
        .map_err(DemoError::node)?;
    let publisher = node
        .publisher_builder::<[u8]>(TOPIC)
        .depth(DEPTH)
        .sealed(arguments.sealed)
        .declare()
        .map_err(DemoError::node)?;
    publisher
        .wait_for_subscribers_timeout(arguments.subscribers as usize, GATHERING)
        .map_err(DemoError::node)?;
    send_event(&ProcessEvent::Ready).map_err(DemoError::Output)?;
    let mut stdin = io::stdin();
    let mut line = [0; START.len()];
    if stdin.read_exact(&mut line).is_err() {
        return Ok(());
    }
    let figures = publish(arguments, &node, &publisher)?;
    wait_for_releases(&node, &publisher)?;
    send_event(&ProcessEvent::Done(figures)).map_err(DemoError::Output)?;
    // Until standard input ends, the director measures this process, and subscribers read from its
    // memory.
    let end = |_| DemoError::Output(io::ErrorKind::BrokenPipe.into());
    stdin.read(&mut line).map_err(end)?;
    Ok(())
}

/// Publishes each message at a fixed time after the first one, so that one late message does not delay
/// the others.
fn publish(
    arguments: &ProcessArguments,
    node: &Node,
    publisher: &Publisher<[u8]>,
) -> Result<Figures, DemoError> {
    let start = clock::now();
    let due = |number: u64| {
        Instant(
            start
                .0
                .saturating_add(arguments.period.saturating_mul(number)),
        )
    };
    let end = due(arguments.count);
    let mut figures = Figures::default();
    let (mut report_at, mut reported) = (start.after(SECOND), (start, 0));
    for number in 0..arguments.count {
        // A slow machine publishes fewer messages in the same time.
        if pause(node, io::stdin().as_fd(), due(number))? || clock::now() >= end {
            break;
        }
        let mut loan = publisher
            .loan_slice(arguments.size as usize)
            .map_err(DemoError::node)?;
        pattern::fill(number, &mut loan);
        loan.publish().map_err(DemoError::node)?;
        figures.messages += 1;
        let now = clock::now();
        if now >= report_at {
            let (since, before) = reported;
            figures.hz = (figures.messages - before) as f64 / now.since(since).as_secs_f64();
            (report_at, reported) = (now.after(SECOND), (now, figures.messages));
            send_event(&ProcessEvent::Progress(figures)).map_err(DemoError::Output)?;
        }
    }
    let seconds = clock::now().since(start).as_secs_f64();
    figures.hz = hundredths(figures.messages as f64 / seconds);
    Ok(figures)
}

/// Waits until subscribers have released all messages, or until the timeout.
fn wait_for_releases(node: &Node, publisher: &Publisher<[u8]>) -> Result<(), DemoError> {
    let until = clock::now().after(RELEASE_TIMEOUT);
    while publisher.counters().in_flight > 0 && clock::now() < until {
        // A release by a ring wakes a publisher only if it waits for room, so poll.
        let soon = clock::now().after(LOOK).min(until);
        let ready = drive(node, &[io::stdin().as_fd()], Some(soon))?;
        if ready == [true] {
            break;
        }
    }
    Ok(())
}
