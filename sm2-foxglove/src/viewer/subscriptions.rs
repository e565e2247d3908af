//! The topics that a viewer looks at.

use std::{collections::BTreeMap, sync::Arc};

use sm2_node::{Sample, Subscriber, wait_set::Key};

use super::context::{Context, End, Source};
use crate::{
    catalogue::Channel,
    frame,
    outbox::Room,
    protocol::{self, Level, Subscription},
};

/// The messages of a publisher that may wait until the thread of the viewer takes them. A topic with latched messages
/// has room for all of them.
const DEPTH: u16 = 8;

/// Messages of a topic that are taken before the other sources have their turn.
const TAKE_BURST: usize = 64;

/// The subscriptions of a viewer.
#[derive(Default)]
pub(super) struct Subscriptions {
    /// By the numbers that the viewer has given to them.
    topics: BTreeMap<u32, Topic>,
}

/// A topic that a viewer looks at.
struct Topic {
    channel: Arc<Channel>,
    subscriber: Subscriber<[u8]>,
    key: Key,
    /// Whether the viewer was told that a message cannot be shown.
    has_complained: bool,
}

impl Subscriptions {
    /// Subscribes to the topic of a channel.
    pub(super) fn add(&mut self, context: &mut Context, wanted: Subscription) -> Result<(), End> {
        let Subscription { id, channel_id } = wanted;
        let Some(channel) = context.snapshot.channels.get(&channel_id).cloned() else {
            // The channel may have ended a moment ago.
            return context.complain(Level::Warning, format!("there is no channel {channel_id}"));
        };
        if self.topics.contains_key(&id) {
            return context.complain(
                Level::Error,
                format!("the subscription {id} exists already"),
            );
        }
        // A subscriber of one type would refuse the next publisher of the topic if that has another type.
        let builder = context
            .shared
            .node
            .subscriber_builder::<[u8]>(channel.topic.as_str());
        let builder = builder
            .any_type()
            .depth(channel.latched.max(DEPTH))
            .max_borrowed(1);
        let subscriber = match builder.declare() {
            Ok(subscriber) => subscriber,
            Err(error) => return context.complain(Level::Error, error.to_string()),
        };
        let key = context.set.add(&subscriber, Source::Topic(id))?;
        let topic = Topic {
            channel,
            subscriber,
            key,
            has_complained: false,
        };
        self.topics.insert(id, topic);
        Ok(())
    }

    /// Ends a subscription.
    pub(super) fn remove(&mut self, context: &mut Context, id: u32) {
        if let Some(topic) = self.topics.remove(&id) {
            context.set.remove(topic.key);
            context.outbox.remove(id);
        }
    }

    /// Ends the subscriptions to channels that have ended.
    pub(super) fn end(&mut self, context: &mut Context, channels: &[u64]) {
        let ended = self
            .topics
            .iter()
            .filter(|(_, it)| channels.contains(&it.channel.id));
        let ended: Vec<_> = ended.map(|(id, _)| *id).collect();
        ended.into_iter().for_each(|id| self.remove(context, id));
    }

    /// Puts the messages of a subscription into the outbox.
    pub(super) fn take_messages(&mut self, context: &mut Context, id: u32) -> Result<(), End> {
        for _ in 0..TAKE_BURST {
            let Some(topic) = self.topics.get(&id) else {
                return Ok(());
            };
            let problem = match topic.subscriber.try_recv() {
                Ok(None) => return Ok(()),
                // The type of a publisher that is not of this channel.
                Ok(Some(sample)) if sample.type_id() != Some(&topic.channel.data) => continue,
                Ok(Some(sample)) => match put(context, id, &topic.channel, &sample) {
                    Ok(Room::Free | Room::Full) => continue,
                    Ok(Room::TooLong) => "longer than the budget of a viewer".to_owned(),
                    Err(problem) => problem,
                },
                Err(error) => error.to_string(),
            };
            self.complain_about(context, id, &problem)?;
        }
        Ok(())
    }

    /// Tells the viewer once for each subscription that messages cannot be shown.
    fn complain_about(&mut self, context: &mut Context, id: u32, problem: &str) -> Result<(), End> {
        let Some(topic) = self.topics.get_mut(&id).filter(|it| !it.has_complained) else {
            return Ok(());
        };
        topic.has_complained = true;
        let message = format!(
            "a message of {} is not shown: {problem}",
            topic.channel.topic
        );
        context.complain(Level::Warning, message)
    }
}

/// Puts a message into the outbox, in the form of its channel.
fn put(
    context: &mut Context,
    id: u32,
    channel: &Channel,
    sample: &Sample<[u8]>,
) -> Result<Room, String> {
    let head = protocol::message_head(id, context.time_of(sample.source_time()));
    let message_type = &channel.message_type;
    if message_type.is_unchanged() {
        // Before the copy: a message that cannot wait is not copied, and those that it displaces are gone.
        let len = frame::HEAD_MAX + head.len() + sample.len();
        let room = context.outbox.make_room(id, len);
        return Ok(match room {
            Room::Free => (context.outbox).push(id, frame::binary(&[&head[..], sample])),
            Room::Full | Room::TooLong => room,
        });
    }
    if let Some(max) = message_type.max_len().filter(|max| sample.len() > *max) {
        let len = sample.len();
        return Err(format!(
            "{len} bytes long, and at most {max} are converted to JSON"
        ));
    }
    // A copy: the publisher may still be able to change the message while it is decoded.
    let message = sample.to_vec();
    let json = message_type.to_viewer(&message);
    let json = json.map_err(|error| error.to_string())?;
    Ok((context.outbox).push(id, frame::binary(&[&head[..], &json])))
}
