//! Subscribing to topics, in as many sessions as they need.

use sm2_node::domain::Domain;
use sm2_node::{ConnectError, DeclareError, Node};
use sm2_proto::{Name, Quota};

use super::topic::{Topic, Wait};
use super::{DEPTH, Event, HELD_MAX, Recorder};
use crate::error::RecordError;
use crate::missing::MissingTopic;
use crate::patterns::Pattern;
use crate::queue::Item;

impl<'fd> Recorder<'fd> {
    /// Lets the recorder connect a further session, with the node that `connect` returns, whenever a session has as
    /// many interfaces as the Manager allows.
    pub fn connect_with(
        &mut self,
        connect: impl FnMut() -> Result<Node, ConnectError> + Send + 'fd,
    ) {
        self.connect = Some(Box::new(connect));
    }

    /// Subscribes to the next new topic, if there is room for it.
    pub(super) fn subscribe_next(&mut self) -> Result<(), RecordError> {
        let (domain, now_ns) = (self.watch.domain(), self.now_ns());
        let next = self.new_topics.next(domain, &mut self.topics, now_ns);
        let result = next.map_or(Ok(()), |topic| {
            let subscribed = self.subscribe_in_a_session(&topic);
            self.new_topics.set_subscribed(topic, subscribed, now_ns)
        });
        for missing in self.new_topics.take_changes() {
            self.queue.push(Item::Missing(missing));
        }
        result
    }

    /// Subscribes to a topic. If the session has as many interfaces as it may have, connects another one.
    fn subscribe_in_a_session(&mut self, topic: &Name) -> Result<(), RecordError> {
        let subscribed = self.subscribe(topic);
        let is_full = matches!(
            subscribed,
            Err(RecordError::Declare(DeclareError::Quota {
                quota: Quota::InterfacesPerSession | Quota::LinksPerSession,
                ..
            }))
        );
        // A session that is full without a topic leaves no room for any.
        let helps = is_full && self.in_session > 0;
        match self.connect.as_mut().filter(|_| helps).map(|it| it()) {
            None => subscribed,
            Some(Ok(node)) => {
                self.nodes.push(std::mem::replace(&mut self.node, node));
                self.in_session = 0;
                self.subscribe(topic)
            }
            Some(Err(error)) => {
                tracing::error!(%error, "cannot connect a further session for more topics");
                subscribed
            }
        }
    }

    pub(super) fn subscribe(&mut self, name: &Name) -> Result<(), RecordError> {
        let builder = self.node.subscriber_builder::<[u8]>(name.as_str());
        let subscriber = builder
            .any_type()
            .depth(DEPTH)
            // One more than are held, so that the next message can always be taken.
            .max_borrowed(HELD_MAX as u16 + 1)
            .reliable(self.options.reliable.contains(name))
            // The recorder itself leaves out what is too long: a message that is not sent could not be counted.
            //= SM2-QOS-008
            .max_len(u64::MAX)
            .declare()?;
        let number = self.topics.len();
        let added = self.set.add(&subscriber, Event::Topic(number));
        let key = added.map_err(RecordError::System)?;
        let is_reliable = self.options.reliable.contains(name);
        let now_ns = self.now_ns();
        self.topics
            .push(Topic::new(subscriber, key, is_reliable, now_ns));
        self.in_session += 1;
        Ok(())
    }

    /// Forgets publishers that have left, if some may have. Tells the writer about the latched ones.
    pub(super) fn forget_publishers(&mut self) -> Result<(), RecordError> {
        let Some(left) = self.looks_left.checked_sub(1) else {
            return Ok(());
        };
        self.looks_left = left;
        for number in 0..self.topics.len() {
            if !self.topics[number].look_who_left() {
                continue;
            }
            // The next poll takes the messages of the others.
            if self.topics[number].wait != Wait::Poll {
                self.receive(number)?;
            }
            let topic = &mut self.topics[number];
            for source in topic.take_left(&self.queue) {
                self.queue.push(Item::Left(source));
            }
            if topic.has_left() {
                self.looks_left = self.looks_left.max(1);
            }
        }
        Ok(())
    }

    /// The domain as the recorder knows it.
    #[must_use]
    pub const fn domain(&self) -> &Domain {
        self.watch.domain()
    }

    /// The topics and patterns of the [options](super::Options::topics) without a publisher so far: topics that were
    /// never linked, and patterns that no topic has matched.
    pub fn unmatched(&mut self) -> Vec<String> {
        self.topics.iter_mut().for_each(Topic::look_for_link);
        let topics = self.topics.iter().filter(|it| !it.was_linked);
        let topics = topics.map(|it| it.subscriber.topic());
        let named = topics.filter(|it| self.options.topics.is_named(it));
        let named = named.map(ToString::to_string);
        let patterns = self.new_topics.unmatched().iter();
        named
            .chain(patterns.map(|it| it.as_str().to_owned()))
            .collect()
    }

    /// Reports the topics that have never had a link, and the patterns that no topic has matched.
    pub(super) fn report_unlinked(&mut self) {
        let missing = |it: &Pattern| MissingTopic {
            topic: it.as_str().to_owned(),
            reason: "no topic matched".to_owned(),
            from_ns: self.clock.wall_ns,
            to_ns: None,
        };
        for missing in self.new_topics.unmatched().iter().map(missing) {
            self.queue.push(Item::Missing(missing));
        }
        for topic in &mut self.topics {
            topic.look_for_link();
            if !topic.was_linked {
                self.queue.push(Item::Missing(MissingTopic {
                    topic: topic.subscriber.topic().to_string(),
                    reason: "no publisher was linked".to_owned(),
                    from_ns: topic.since_ns,
                    to_ns: None,
                }));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::os::fd::AsFd;
    use std::time::Duration;

    use sm2_manager::Background;
    use sm2_node::Shutdown;
    use sm2_test_support::until;

    use super::super::{Options, Topics};
    use super::*;

    #[test]
    fn publishers_that_have_left_take_no_memory() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("sock");
        let _manager = Background::start(&socket, sm2_manager::Options::default()).unwrap();
        let connect = |name: &str| Node::builder(name).socket(&socket).connect().unwrap();
        let (node, shutdown) = (connect("recorder"), Shutdown::new().unwrap());
        let file = File::create_new(folder.path().join("bag")).unwrap();
        let options = Options {
            sync_interval: Duration::from_millis(1),
            ..Options::new(Topics::All)
        };
        let mut recorder = Recorder::start(&node, file, options, shutdown.as_fd()).unwrap();
        for number in 1..=20 {
            let talker = connect(&format!("talker/{number}"));
            let publisher = talker.publisher::<u64>("numbers").unwrap();
            until("the recorder is linked", || {
                recorder.step(Duration::from_millis(1)).unwrap();
                publisher.links().iter().any(|it| it.open)
            });
            publisher.publish(&number).unwrap();
            until("the number is written", || {
                recorder.step(Duration::from_millis(1)).unwrap();
                recorder.progress().messages == number
            });
        }
        until("all publishers are forgotten", || {
            recorder.step(Duration::from_millis(1)).unwrap();
            recorder.topics[0].publishers() == 0
        });
        assert_eq!(recorder.finish().unwrap().topics[0].messages, 20);
    }

    /// A message that waits shows losses that were counted before: they are counted once.
    #[test]
    fn a_publisher_that_has_left_is_known_until_its_messages_are_taken() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("sock");
        let _manager = Background::start(&socket, sm2_manager::Options::default()).unwrap();
        let connect = |name: &str| Node::builder(name).socket(&socket).connect().unwrap();
        let (node, shutdown) = (connect("recorder"), Shutdown::new().unwrap());
        let file = File::create_new(folder.path().join("bag")).unwrap();
        let name = Name::new("numbers").unwrap();
        let options = Options {
            reliable: [name.clone()].into(),
            ..Options::new(Topics::Named([name].into()))
        };
        let mut recorder = Recorder::start(&node, file, options, shutdown.as_fd()).unwrap();
        let publisher = connect("talker").publisher_builder::<u64>("numbers");
        let publisher = publisher.reliable(true).publish_timeout(Duration::ZERO);
        let publisher = publisher.declare().unwrap();
        until("the recorder is linked", || {
            recorder.step(Duration::from_millis(1)).unwrap();
            publisher.links().iter().any(|it| it.open)
        });
        for number in 0..100 {
            publisher.publish(&number).unwrap();
        }
        until("losses are counted", || {
            recorder.look_at_losses(|_| true);
            recorder.progress().lost > 0
        });
        let lost = recorder.progress().lost;
        assert_eq!(recorder.take(0, 1).unwrap(), 1);
        publisher.publish(&100).unwrap();
        drop(publisher);
        until("the publisher has left", || {
            let links = recorder.topics[0].subscriber.links();
            links.iter().all(|it| !it.open)
        });
        recorder.looks_left = 1;
        recorder.forget_publishers().unwrap();
        assert_eq!(recorder.topics[0].publishers(), 1);
        let topic = recorder.finish().unwrap().topics.remove(0);
        assert_eq!((topic.lost, topic.messages + topic.lost), (lost, 101));
    }
}
