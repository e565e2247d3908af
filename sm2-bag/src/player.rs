//! Publishing the messages of bags again.

mod conductor;
mod control;
mod options;
mod outgoing;
mod pace;
mod publishers;
mod service;
mod timeline;

use std::collections::{BTreeMap, HashMap};
use std::os::fd::BorrowedFd;
use std::path::{Path, PathBuf};
use std::time::Duration;

use sm2_node::{ConnectError, Node, Publisher, WaitError};
use sm2_proto::Name;

pub use self::control::{PlayCommand, PlayCommandError, PlayControl, PlayStatus};
pub use self::options::{LeftOut, PlayOptions, PlayReport, PlayedTopic};
use self::outgoing::Outgoing;
use self::publishers::{Declared, Played};
use self::timeline::Timeline;
use crate::bag::Bag;
use crate::damaged::DamagedPart;
use crate::error::{PlayError, ReadError};
use crate::latched::Whole;
use crate::messages::FoundMessage;

/// A wait for subscribers or for room is cut into steps of this length, so that the caller's descriptor ends it soon.
const STEP: Duration = Duration::from_millis(100);

/// The name of the node of the conductor and of the source of domain time, behind the prefix.
const CONDUCTOR: &str = "conductor";

/// Publishes the messages of one or more bags in the order and at the pace of their `log_time`.
///
/// Each recorded publisher has a publisher with the same type and QoS, in a node of its own name. Before the first
/// message, the player waits until the subscribers that the domain has are linked. If the filter has a first time, the
/// player publishes the latched state as of then first.
///
/// Other threads [control](Self::control) it, and other programs by a [service](Self::serve).
pub struct Player<'a> {
    bags: &'a [Bag],
    options: PlayOptions,
    publishers: Vec<Played>,
    /// The publishers by the number of their bag, and the number of their channel in it.
    channels: HashMap<(usize, u16), usize>,
    omits_clock: bool,
    left_out: Vec<LeftOut>,
    merged_nodes: Option<usize>,
    /// The damaged parts that were found since playing began.
    damaged: Vec<DamagedPart>,
    timeline: Timeline<'a>,
    /// The nodes of the publishers, and that of the conductor.
    _nodes: HashMap<Name, Node>,
}

impl<'a> Player<'a> {
    /// Declares the publishers. A publisher that is in several bags is declared once, with the QoS of the first one.
    /// `connect` returns a node of a name. The descriptor `stop` ends [`play`](Self::play) when it is readable.
    ///
    /// # Errors
    ///
    /// See [`PlayError`].
    pub fn new(
        bags: &'a [Bag],
        options: PlayOptions,
        mut connect: impl FnMut(&str) -> Result<Node, ConnectError>,
        stop: BorrowedFd<'a>,
    ) -> Result<Self, PlayError> {
        let Declared {
            mut nodes,
            publishers,
            channels,
            omits_clock,
            left_out,
            merged_nodes,
        } = Declared::new(bags, &options, &mut connect)?;
        if publishers.is_empty() {
            let path = first_path(bags);
            return Err(PlayError::Empty { path });
        }
        let control = PlayControl::new(options.rate, options.paused);
        let timeline = control.and_then(|it| Timeline::new(stop, it));
        let mut timeline = timeline.map_err(WaitError::Io)?;
        if options.is_clock_source() {
            let node = connect(&options.node_name(CONDUCTOR))?;
            timeline.publish_time(&node)?;
            if options.lockstep.is_some() {
                timeline.conduct(&node)?;
            }
            nodes.insert(node.name().clone(), node);
        }
        Ok(Self {
            bags,
            options,
            publishers,
            channels,
            omits_clock,
            left_out,
            merged_nodes,
            damaged: Vec::new(),
            timeline,
            _nodes: nodes,
        })
    }

    /// Whether recorded messages are left out because they would be a second source of domain time: see
    /// [`PlayOptions::clock`].
    #[must_use]
    pub const fn omits_clock(&self) -> bool {
        self.omits_clock
    }

    /// The number of nodes in the bags, if one node publishes for all of them because they are very many: see
    /// [`PlayOptions::original_names`].
    #[must_use]
    pub const fn merged_nodes(&self) -> Option<usize> {
        self.merged_nodes
    }

    /// Returns a handle that lets any thread control the player.
    #[must_use]
    pub fn control(&self) -> PlayControl {
        self.timeline.control().clone()
    }

    /// Declares a service that lets other programs control the player. The request is a string, the text of a
    /// [`PlayCommand`]. The reply is a string as well, a [`PlayStatus`] in JSON; it comes when the player has followed
    /// the command, so after a step the message is published. While [`play`](Self::play) does not run, no call is
    /// answered.
    ///
    /// # Errors
    ///
    /// [`PlayError::Declare`], [`PlayError::Wait`].
    pub fn serve(&mut self, node: &Node, service: &Name) -> Result<(), PlayError> {
        self.timeline.serve(node, service)
    }

    /// Publishes all messages.
    ///
    /// # Errors
    ///
    /// See [`PlayError`].
    pub fn play(&mut self) -> Result<PlayReport, PlayError> {
        self.damaged = self
            .bags
            .iter()
            .flat_map(|it| it.damaged())
            .cloned()
            .collect();
        let played = self.publish_all();
        let ended = self.timeline.end();
        let complete = played?;
        ended?;
        Ok(self.report(complete))
    }

    /// Publishes all messages. Returns false if the caller ends playing, or if messages are left.
    fn publish_all(&mut self) -> Result<bool, PlayError> {
        let members = self.options.lockstep.unwrap_or(0);
        if !self.timeline.wait_for_members(members)? || !self.wait_for_subscribers()? {
            return Ok(false);
        }
        let mut is_empty = true;
        for (bag, message) in Whole::new(self.bags, &self.options.filter) {
            let message = match message {
                Err(ReadError::Damaged { path, part }) => {
                    leave_out(&mut self.damaged, &path, part);
                    continue;
                }
                found => found?,
            };
            is_empty &= !self.channels.contains_key(&(bag, message.channel.id));
            if !self.publish_found(bag, message)? {
                return Ok(false);
            }
        }
        if is_empty {
            let path = first_path(self.bags);
            return Err(PlayError::Empty { path });
        }
        Ok(self.timeline.finish()? && self.flush()?)
    }

    /// Publishes a message of a bag. Returns false if the caller ends playing.
    fn publish_found(&mut self, bag: usize, message: FoundMessage<'_>) -> Result<bool, PlayError> {
        let Some(&publisher) = self.channels.get(&(bag, message.channel.id)) else {
            // Recorded domain time, which the player publishes itself.
            return Ok(true);
        };
        let time = message.log_time;
        let played = &mut self.publishers[publisher];
        // Before the wait, which a slow disk or a damaged bag would otherwise make late.
        let outgoing = match Outgoing::read(&played.publisher, message.payload) {
            Err(PlayError::Read(ReadError::Damaged { path, part })) => {
                leave_out(&mut self.damaged, &path, part);
                return Ok(true);
            }
            read => read?,
        };
        let room_timeout = self.options.room_timeout;
        if !self.timeline.advance(time)?
            || !publish(
                &mut self.timeline,
                &played.publisher,
                time,
                outgoing,
                room_timeout,
            )?
        {
            return Ok(false);
        }
        played.messages += 1;
        self.timeline.published(time);
        Ok(true)
    }

    /// Waits until the subscribers that are there, and those that the options demand, are linked.
    fn wait_for_subscribers(&mut self) -> Result<bool, PlayError> {
        let demanded = self.options.subscribers;
        let until = sm2_io::clock::now().after(self.options.room_timeout);
        loop {
            let is_early = sm2_io::clock::now() < until;
            let lacks = |it: &Played| {
                let open = it.publisher.links().iter().filter(|link| link.open).count();
                let there = if is_early { it.publisher.matched() } else { 0 };
                open < demanded.max(there)
            };
            let lacks_listener = is_early && self.timeline.lacks_listener();
            if !lacks_listener && !self.publishers.iter().any(lacks) {
                return Ok(true);
            }
            let soon = sm2_io::clock::now().after(Duration::from_millis(1));
            if !self.timeline.wait_until(soon)? {
                return Ok(false);
            }
        }
    }

    /// Waits until subscribers have received everything, for at most the timeout. Returns false if messages are left.
    fn flush(&mut self) -> Result<bool, PlayError> {
        let until = sm2_io::clock::now().after(self.options.room_timeout);
        let mut flushed = true;
        for played in &self.publishers {
            let left = until.since(sm2_io::clock::now());
            flushed &= played.publisher.flush_timeout(left)?;
        }
        Ok(flushed)
    }

    fn report(&self, complete: bool) -> PlayReport {
        let mut topics = BTreeMap::<_, PlayedTopic>::new();
        for played in &self.publishers {
            let topic = topics
                .entry(played.publisher.topic().to_string())
                .or_default();
            let counters = played.publisher.counters();
            topic.messages += played.messages;
            topic.unheard += played.publisher.unheard();
            topic.missed += counters.dropped();
        }
        let topics = topics
            .into_iter()
            .map(|(name, it)| PlayedTopic { name, ..it });
        PlayReport {
            topics: topics.collect(),
            left: self.timeline.left().map(ToString::to_string).collect(),
            left_out: self.left_out.clone(),
            damaged: self.damaged.clone(),
            complete,
        }
    }
}

/// Publishes a message once every reliable subscriber has room, or at the end of the timeout. Returns false if the
/// caller ends playing.
fn publish(
    timeline: &mut Timeline<'_>,
    publisher: &Publisher<[u8]>,
    time: u64,
    mut outgoing: Outgoing<'_>,
    room_timeout: Duration,
) -> Result<bool, PlayError> {
    let until = sm2_io::clock::now().after(room_timeout);
    while sm2_io::clock::now() < until {
        let left = until.since(sm2_io::clock::now());
        match outgoing.publish_or_wait(publisher, left.min(STEP))? {
            None => return Ok(true),
            Some(back) => outgoing = back,
        }
        // A pause holds this message up as well.
        if !timeline.wait_for(time)? {
            return Ok(false);
        }
    }
    outgoing.publish(publisher)?;
    Ok(true)
}

/// Reports that the messages of a damaged part are not played. It may have been read before.
fn leave_out(damaged: &mut Vec<DamagedPart>, path: &Path, part: DamagedPart) {
    if damaged.contains(&part) {
        return;
    }
    tracing::error!(path = %path.display(), %part, "a damaged part of the bag is left out");
    damaged.push(part);
}

/// The path that errors name.
fn first_path(bags: &[Bag]) -> PathBuf {
    bags.first()
        .map(|it| it.path().to_owned())
        .unwrap_or_default()
}
