//! Recorders of SM2's topics: that of `sm2-bag`, and a program that passes messages to the crate `mcap`.

use std::{collections::BTreeSet, os::fd::AsFd, os::unix::net::UnixStream, thread, time::Duration};

use sm2_bag::{BagFile, Options, Recorder, Step, Topics};
use sm2_node::{Name, Node, Subscriber, WaitSet};

use crate::{
    control::{Stage, reached, wait_for},
    job::{Channel, Recording},
    peers::{contract::PeerError, mcap_file::McapFile},
};

/// How many messages of a publisher wait for the program with the crate `mcap`: as many as for `sm2-bag`.
const DEPTH: u16 = 64;

/// How often the program with the crate `mcap` checks whether to stop.
const LOOK: Duration = Duration::from_millis(20);

/// Records with `sm2-bag`: the frames are reliable, and all other topics keep-last.
pub(super) fn bag(
    node: &Node,
    recording: &Recording,
    ready: impl FnOnce(),
) -> Result<(), PeerError> {
    let (stop, stopper) =
        UnixStream::pair().map_err(PeerError::caused("make a pair of sockets"))?;
    thread::spawn(move || {
        wait_for(Stage::Stop);
        // The recorder sees the end of the stream.
        drop(stopper);
    });
    let name =
        |channel: &Channel| Name::new(&channel.name).map_err(PeerError::caused("name a topic"));
    let frames = name(&recording.frames)?;
    let small: Result<Vec<_>, _> = recording.small.iter().map(name).collect();
    let mut topics = BTreeSet::from_iter(small?);
    topics.insert(frames.clone());
    let options = Options {
        reliable: BTreeSet::from([frames]),
        sync_interval: Duration::from_millis(recording.sync_ms),
        ..Options::new(Topics::Named(topics))
    };
    let file = BagFile::create(&recording.file).map_err(PeerError::caused("make the file"))?;
    let mut recorder =
        Recorder::start(node, file, options, stop.as_fd()).map_err(PeerError::caused("record"))?;
    ready();
    loop {
        let step = recorder.step(Duration::from_secs(1));
        match step.map_err(PeerError::caused("record"))? {
            Step::Stopped => break,
            Step::DiskFull => return Err(PeerError::new("record", "the disk is full")),
            Step::Timeout | Step::Woken => {}
        }
    }
    recorder
        .finish()
        .map_err(PeerError::caused("complete the file"))?;
    Ok(())
}

/// Records with the crate `mcap`, on one thread: the frames are reliable, and all other topics keep-last.
pub(super) fn mcap(
    node: &Node,
    recording: &Recording,
    ready: impl FnOnce(),
) -> Result<(), PeerError> {
    let channels = recording.channels();
    let topics = channels.iter().map(|it| it.name.as_str());
    let mut file = McapFile::create(&recording.file, topics)?;
    let mut set = WaitSet::new().map_err(PeerError::caused("make a wait set"))?;
    let mut subscribers = Vec::new();
    for (number, channel) in channels.iter().enumerate() {
        let builder = node.subscriber_builder::<[u8]>(&channel.name);
        let builder = builder.depth(DEPTH).reliable(number == 0);
        let subscriber = builder
            .declare()
            .map_err(PeerError::caused("declare a subscriber"))?;
        set.add(&subscriber, number)
            .map_err(PeerError::caused("wait for a subscriber"))?;
        subscribers.push(subscriber);
    }
    ready();
    while !reached(Stage::Stop) {
        let source = set.wait_timeout(LOOK).map_err(PeerError::caused("wait"))?;
        if let Some(source) = source {
            take(&subscribers[source.tag], source.tag, &mut file)?;
        }
    }
    for (number, subscriber) in subscribers.iter().enumerate() {
        take(subscriber, number, &mut file)?;
    }
    file.finish()
}

/// Writes the messages that have come, at most those of one queue.
fn take(
    subscriber: &Subscriber<[u8]>,
    number: usize,
    file: &mut McapFile,
) -> Result<(), PeerError> {
    for _ in 0..DEPTH {
        match subscriber
            .try_recv()
            .map_err(PeerError::caused("receive"))?
        {
            Some(sample) => file.write(number, &sample)?,
            None => break,
        }
    }
    Ok(())
}
