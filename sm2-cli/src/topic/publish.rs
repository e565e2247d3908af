//! `sm2 topic pub`: publishes files, standard input or a value.

mod arguments;
mod payload;
mod summary;

use std::{os::fd::BorrowedFd, time::Duration};

use sm2_io::clock;
use sm2_node::{Publisher, Timer, WaitError};
use sm2_proto::{Instant, Kind};

pub(crate) use self::arguments::Arguments;
use self::{
    payload::Payload,
    summary::{Summary, Tally},
};
use super::{
    source::{Gate, Input, Messages},
    wait_hint,
};
use crate::{
    args::{Integrity, with_option},
    connect::{CommandNode, drive},
    ended::Ended,
    error::CliError,
    output::Output,
    wait::For,
};

/// The number of messages that wait for a subscriber.
const DEPTH: u16 = 64;

/// A reliable subscriber that receives nothing for this time no longer delays the publisher.
const TIMEOUT: Duration = Duration::from_secs(10);

/// The timeout at the end for messages to subscribers that are not reliable.
const FAREWELL: Duration = Duration::from_secs(1);

/// The timeout for subscribers to release their messages before the summary is printed.
const RELEASE_TIMEOUT: Duration = Duration::from_millis(200);

/// A wait is cut into steps of this length, so that a signal ends the wait soon.
const STEP: Duration = Duration::from_millis(100);

/// Runs the command until all messages are published or a signal comes.
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    if arguments.again && arguments.from == Some(Input::StandardInput) {
        return Err(CliError::LoopOfInput);
    }
    let value = payload::value(arguments)?;
    let inputs = match &arguments.from {
        Some(input) => input.inputs()?,
        None => Vec::new(),
    };
    let command_node = CommandNode::open(&arguments.domain, "pub")?;
    let message = Payload::new(arguments, &command_node, value.as_ref())?;
    let publisher = declare(arguments, &command_node, &message)?;
    let mut feed = Feed {
        arguments,
        value: message.bytes.as_deref(),
        command_node: &command_node,
        publisher: &publisher,
        tally: Tally::default(),
        ticks: None,
    };
    let mut flushed = true;
    if feed.wait_for_subscribers()? {
        let all = feed.publish_all(&inputs);
        // After an error, the messages that were already published are flushed too.
        flushed = feed.flush()?;
        all?;
        feed.wait_for_releases()?;
    }
    let counters = publisher.counters();
    feed.tally.unheard = publisher.unheard();
    let summary = Summary(feed.tally, counters);
    match arguments.json {
        true => Output::new().json(&summary)?,
        false => stderr_line!("{summary}"),
    }
    let missed = match flushed {
        false if arguments.reliable => counters.no_room + counters.in_flight,
        _ => counters.no_room,
    };
    let links = publisher.links();
    let reliable = || links.iter().filter(|link| link.reliable);
    let missed = missed + reliable().map(|it| it.counters.pool_limit).sum::<u64>();
    let too_long = reliable().map(|it| it.counters.too_long).sum();
    match command_node.stopped() {
        // With --loop, Ctrl-C is the regular end.
        Some(signal) if !arguments.again => Ok(Ended::Stopped(signal)),
        Some(_) => Ok(Ended::Done),
        None if missed > 0 => Err(CliError::TooSlow {
            messages: missed,
            seconds: TIMEOUT.as_secs(),
        }),
        None if too_long > 0 => Err(CliError::NotAccepted { messages: too_long }),
        None => Ok(Ended::Done),
    }
}

fn declare(
    arguments: &Arguments,
    command_node: &CommandNode,
    message: &Payload,
) -> Result<Publisher<[u8]>, CliError> {
    let topic = arguments.topic.as_str();
    let builder = command_node
        .node
        .publisher_builder::<[u8]>(topic)
        .type_id(message.data.clone())
        .depth(DEPTH)
        .reliable(arguments.reliable)
        .sealed(arguments.integrity == Integrity::Sealed);
    let builder = with_option(builder, arguments.deadline, |it, time| it.deadline(time));
    let builder = with_option(builder, arguments.lifespan, |it, time| it.lifespan(time));
    let builder = with_option(builder, arguments.liveliness, |it, time| {
        it.liveliness(time)
    });
    let builder = with_option(builder, arguments.pool_limit, |it, size| {
        it.pool_limit(size.0)
    });
    Ok(builder.declare()?)
}

/// Publishes the messages of the inputs.
struct Feed<'a> {
    arguments: &'a Arguments,
    /// The message of `--value`; `None` if `--from` is given.
    value: Option<&'a [u8]>,
    command_node: &'a CommandNode,
    publisher: &'a Publisher<[u8]>,
    tally: Tally,
    /// The times of messages that are published at a fixed rate.
    ticks: Option<Timer>,
}

impl Feed<'_> {
    /// Waits for subscribers. Returns false if a signal came first.
    fn wait_for_subscribers(&self) -> Result<bool, CliError> {
        let count = self.arguments.wait;
        let mut hint_at = Some(clock::now().after(wait_hint::DELAY));
        while self.command_node.stopped().is_none() {
            match self.publisher.wait_for_subscribers_timeout(count, STEP) {
                Ok(()) => return Ok(true),
                Err(WaitError::TimedOut { .. }) => {}
                Err(error) => return Err(error.into()),
            }
            if hint_at.is_some_and(|at| at <= clock::now()) {
                hint_at = None;
                let links = self.publisher.links();
                wait_hint::print(
                    self.command_node,
                    &self.arguments.topic,
                    Kind::Subscriber,
                    count,
                    &links,
                );
            }
        }
        Ok(false)
    }

    fn publish_all(&mut self, inputs: &[Input]) -> Result<(), CliError> {
        loop {
            let before = self.tally.messages;
            self.publish_round(inputs)?;
            if !self.arguments.again || self.command_node.stopped().is_some() {
                return Ok(());
            }
            if self.tally.messages == before {
                return Err(CliError::NothingToLoop);
            }
        }
    }

    /// Publishes every message of every input once, or fewer if a signal comes.
    fn publish_round(&mut self, inputs: &[Input]) -> Result<(), CliError> {
        if let Some(value) = self.value {
            if self.wait_for_tick()? {
                self.publish(value)?;
            }
            return Ok(());
        }
        let gate = self.command_node;
        let mut messages = Messages::new(inputs.to_vec(), self.arguments.split(), gate);
        let mut message = Vec::new();
        while messages.next(&mut message)? {
            if !self.wait_for_tick()? || !self.publish(&message)? {
                return Ok(());
            }
        }
        Ok(())
    }

    /// Publishes a message once every reliable subscriber has room for it, and waits at most [`TIMEOUT`] for that. A
    /// subscriber without room then misses the message, and is not waited for until it receives one. Returns false,
    /// and publishes nothing, if a signal comes.
    fn publish(&mut self, message: &[u8]) -> Result<bool, CliError> {
        let until = clock::now().after(TIMEOUT);
        let published = loop {
            if self.command_node.stopped().is_some() {
                return Ok(false);
            }
            if let Some(published) = self.publisher.try_publish(message)? {
                break published;
            }
            if clock::now() >= until {
                break self.publisher.publish_timeout(message, Duration::ZERO)?;
            }
            self.publisher.wait_for_room_timeout(STEP)?;
            self.command_node.is_connected();
        };
        self.tally.links = self.tally.links.max(published.links);
        self.tally.messages += 1;
        self.tally.bytes += message.len() as u64;
        Ok(true)
    }

    /// Waits until the next message is due. Returns false if a signal comes.
    fn wait_for_tick(&mut self) -> Result<bool, CliError> {
        match &mut self.ticks {
            Some(ticks) => {
                while ticks.handle(clock::now()).is_none() {
                    let due = ticks.deadline().unwrap_or(Instant(u64::MAX));
                    if self.command_node.pause(due)? {
                        return Ok(false);
                    }
                }
            }
            // The first message is due now.
            none => *none = self.arguments.rate.map(|hz| self.arguments.ticks(hz)),
        }
        Ok(true)
    }

    /// Waits until subscribers have received all messages: without limit while reliable subscribers make
    /// progress, and up to [`FAREWELL`] for the others. Returns false if messages were left.
    fn flush(&self) -> Result<bool, CliError> {
        let mut seen = self.publisher.counters();
        let mut until = clock::now().after(if self.arguments.reliable {
            TIMEOUT
        } else {
            FAREWELL
        });
        let mut stopping = false;
        while !self.publisher.flush_timeout(STEP)? {
            let now = clock::now();
            let counters = self.publisher.counters();
            if self.command_node.stopped().is_some() && !stopping {
                stopping = true;
                until = until.min(now.after(FAREWELL));
            } else if self.arguments.reliable && !stopping && counters != seen {
                until = now.after(TIMEOUT);
            }
            seen = counters;
            if now >= until {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Waits up to [`RELEASE_TIMEOUT`] for subscribers to release their messages, so that the counts are final.
    fn wait_for_releases(&self) -> Result<(), CliError> {
        let until = clock::now().after(RELEASE_TIMEOUT);
        while self.publisher.counters().in_flight > 0 && clock::now() < until {
            drive(&self.command_node.node, &[], Some(until))?;
        }
        Ok(())
    }
}

impl Gate for CommandNode {
    fn pass(&self, input: BorrowedFd<'_>) -> Result<bool, CliError> {
        while self.stopped().is_none() {
            if self.step(&[(input, For::Reading)], None)?[0] {
                return Ok(self.stopped().is_none());
            }
        }
        Ok(false)
    }
}
