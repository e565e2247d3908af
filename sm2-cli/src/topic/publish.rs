//! `sm2 topic pub`: files or standard input as messages.

use std::{fmt, os::fd::BorrowedFd, time::Duration};

use sm2_io::clock;
use sm2_node::{Publisher, WaitError};
use sm2_proto::{Contract, Instant, Kind, TypeId, control::Item, link::Counters};

use super::{
    PubArguments, hint,
    room::{DEPTH, PATIENCE, Room},
    source::{Gate, Input, Messages},
};
use crate::{
    Ended,
    args::Integrity,
    connect::{Session, step},
    error::CliError,
    size::Size,
    wait::For,
};

/// How long messages may take at the end to reach subscribers that nobody promised anything.
const FAREWELL: Duration = Duration::from_secs(1);

/// How long receivers may take to give back what they have, before the summary is printed.
const SETTLING: Duration = Duration::from_millis(200);

/// A wait is cut into steps of this length, to look for signals in between.
const STEP: Duration = Duration::from_millis(100);

/// Publishes until all is published, or a signal comes.
pub(super) fn run(arguments: &PubArguments) -> Result<Ended, CliError> {
    if arguments.again && arguments.from == Input::StandardInput {
        return Err(CliError::LoopOfInput);
    }
    let inputs = arguments.from.inputs()?;
    let session = Session::open(&arguments.domain, "pub")?;
    let publisher = declare(arguments, &session)?;
    let mut feed = Feed {
        arguments,
        session: &session,
        publisher: &publisher,
        tally: Tally::default(),
        pace: None,
        room: Room::default(),
    };
    let mut flushed = true;
    if feed.wait_for_subscribers()? {
        let all = feed.publish_all(&inputs);
        // Also what was published before an error.
        flushed = feed.flush()?;
        all?;
        feed.settle()?;
    }
    let counters = publisher.counters();
    eprintln!("{}", Summary(feed.tally, counters));
    let missed = match flushed {
        false if arguments.reliable => counters.deadline + counters.in_flight,
        _ => counters.deadline,
    };
    match session.stopped() {
        // Ctrl-C is how it ends that has no other end.
        Some(signal) if !arguments.again => Ok(Ended::Stopped(signal)),
        Some(_) => Ok(Ended::Done),
        None if missed > 0 => Err(CliError::TooSlow {
            messages: missed,
            seconds: PATIENCE.as_secs(),
        }),
        None => Ok(Ended::Done),
    }
}

fn declare(arguments: &PubArguments, session: &Session) -> Result<Publisher<[u8]>, CliError> {
    let topic = arguments.topic.as_str();
    let builder = session
        .node
        .publisher_builder::<[u8]>(topic)
        .type_id(data_type(arguments, session)?)
        .depth(DEPTH)
        .sealed(arguments.integrity == Integrity::Sealed);
    let builder = match arguments.reliable {
        // What waits is `wait_for_room`, which a signal can end.
        true => builder.reliable(Duration::ZERO),
        false => builder,
    };
    Ok(builder.declare()?)
}

/// The type to declare: one that is named without its hash is taken to be the one in use.
fn data_type(arguments: &PubArguments, session: &Session) -> Result<TypeId, CliError> {
    let (name, topic) = (&arguments.data.name, &arguments.topic);
    let hash = match arguments.data.hash {
        Some(hash) => hash,
        None if name.as_str() == "bytes" => 0,
        None => {
            let graph = session.graph()?;
            let mut contracts = graph.items.iter().filter_map(|item| match item {
                Item::Interface { contract, .. } if contract.name() == topic => Some(contract),
                _ => None,
            });
            let in_use = contracts.find_map(|contract| match contract {
                Contract::Publisher { data, .. } => Some(data),
                Contract::Subscriber { data, .. } => data.as_ref(),
                Contract::Server { .. } | Contract::Client { .. } => None,
            });
            in_use
                .filter(|data| data.name == *name)
                .map_or(0, |data| data.hash)
        }
    };
    let name = name.clone();
    Ok(TypeId { name, hash })
}

/// From inputs to the publisher.
struct Feed<'a> {
    arguments: &'a PubArguments,
    session: &'a Session,
    publisher: &'a Publisher<[u8]>,
    tally: Tally,
    pace: Option<Pace>,
    room: Room,
}

/// When messages are due: so often from the first one on, however long each takes.
#[derive(Clone, Copy, Debug)]
struct Pace {
    start: Instant,
    hz: f64,
}

impl Pace {
    fn due(self, message: u64) -> Instant {
        let after = Duration::try_from_secs_f64(message as f64 / self.hz);
        self.start.after(after.unwrap_or(Duration::MAX))
    }
}

impl Feed<'_> {
    /// Whether they came; else there was a signal.
    fn wait_for_subscribers(&self) -> Result<bool, CliError> {
        let count = self.arguments.wait;
        let mut hint_at = Some(clock::now().after(hint::AFTER));
        while self.session.stopped().is_none() {
            match self.publisher.wait_for_subscribers(count, Some(STEP)) {
                Ok(()) => return Ok(true),
                Err(WaitError::TimedOut { .. }) => {}
                Err(error) => return Err(error.into()),
            }
            if hint_at.is_some_and(|at| at <= clock::now()) {
                hint_at = None;
                hint::say(self.session, &self.arguments.topic, Kind::Subscriber, count);
            }
        }
        Ok(false)
    }

    fn publish_all(&mut self, inputs: &[Input]) -> Result<(), CliError> {
        loop {
            let before = self.tally.messages;
            self.publish_round(inputs)?;
            if !self.arguments.again || self.session.stopped().is_some() {
                return Ok(());
            }
            if self.tally.messages == before {
                return Err(CliError::NothingToLoop);
            }
        }
    }

    /// Publishes every message of every input once; less if a signal comes.
    fn publish_round(&mut self, inputs: &[Input]) -> Result<(), CliError> {
        let gate = self.session;
        let mut messages = Messages::new(inputs.to_vec(), self.arguments.split(), gate);
        let mut message = Vec::new();
        while messages.next(&mut message)? {
            if !self.wait_for_turn()? {
                return Ok(());
            }
            let published = self.publisher.publish(&message)?;
            self.tally.links = self.tally.links.max(published.links);
            self.tally.messages += 1;
            self.tally.bytes += message.len() as u64;
        }
        Ok(())
    }

    /// Waits until the next message is due and has room; false when a signal comes.
    fn wait_for_turn(&mut self) -> Result<bool, CliError> {
        if let Some(hz) = self.arguments.rate {
            let start = clock::now();
            let pace = *self.pace.get_or_insert(Pace { start, hz });
            if self.session.pause(pace.due(self.tally.messages))? {
                return Ok(false);
            }
        }
        self.wait_for_room()
    }

    /// Waits until the next message has room on every reliable link, or was waited for long enough;
    /// false when a signal comes.
    fn wait_for_room(&mut self) -> Result<bool, CliError> {
        while self.session.stopped().is_none() {
            if self.room.take() {
                return Ok(true);
            }
            let links = self.publisher.links().into_iter();
            let reliable = links.filter(|link| link.open && link.reliable);
            let counters = reliable.map(|link| (link.id, link.counters));
            let now = clock::now();
            if !self.room.look(now, counters) {
                self.session.step(&[], Some(now.after(STEP)))?;
            }
        }
        Ok(false)
    }
    /// Waits until subscribers have what was published: as long as reliable ones go on taking it, and
    /// a moment for the others. Whether they have.
    fn flush(&self) -> Result<bool, CliError> {
        let mut seen = self.publisher.counters();
        let mut until = clock::now().after(if self.arguments.reliable {
            PATIENCE
        } else {
            FAREWELL
        });
        let mut stopping = false;
        while !self.publisher.flush(STEP)? {
            let now = clock::now();
            let counters = self.publisher.counters();
            if self.session.stopped().is_some() && !stopping {
                stopping = true;
                until = until.min(now.after(FAREWELL));
            } else if self.arguments.reliable && !stopping && counters != seen {
                until = now.after(PATIENCE);
            }
            seen = counters;
            if now >= until {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Gives receivers a moment to give back what they have, so that the counts are final.
    fn settle(&self) -> Result<(), CliError> {
        let until = clock::now().after(SETTLING);
        while self.publisher.counters().in_flight > 0 && clock::now() < until {
            step(&self.session.node, &[], Some(until))?;
        }
        Ok(())
    }
}

impl Gate for Session {
    fn pass(&self, input: BorrowedFd<'_>) -> Result<bool, CliError> {
        while self.stopped().is_none() {
            if self.step(&[(input, For::Reading)], None)?[0] {
                return Ok(self.stopped().is_none());
            }
        }
        Ok(false)
    }
}

/// What was published.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    messages: u64,
    bytes: u64,
    /// The most that a message was sent on.
    links: usize,
}

/// What is said at the end: what was published, and what became of it on all links together.
struct Summary(Tally, Counters);

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(tally, counters) = self;
        let plural = |count: u64| if count == 1 { "" } else { "s" };
        write!(
            f,
            "published {} message{} ({}) to {} subscriber{}: {} delivered",
            tally.messages,
            plural(tally.messages),
            Size(tally.bytes),
            tally.links,
            plural(tally.links as u64),
            counters.delivered,
        )?;
        if counters.in_flight > 0 {
            write!(f, ", {} not given back yet", counters.in_flight)?;
        }
        let dropped = [
            (counters.overwritten, "overtaken before they were sent"),
            (counters.discarded, "overtaken before they were taken"),
            (counters.deadline, "too late for a subscriber without room"),
            (counters.closed, "to subscribers that left"),
        ];
        write!(
            f,
            ", {} dropped",
            dropped.iter().map(|(count, _)| count).sum::<u64>()
        )?;
        let reasons: Vec<_> = dropped
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, reason)| format!("{count} {reason}"))
            .collect();
        match reasons.is_empty() {
            true => Ok(()),
            false => write!(f, " ({})", reasons.join(", ")),
        }
    }
}
