//! The triggers of a black box.

use std::path::Path;
use std::time::Duration;

use sm2_node::{Node, RecvError, Request, Server, Subscriber};
use sm2_proto::{Instant, Name};

use crate::error::RecordError;
use crate::recorder::Recorder;

/// An event that lets a black box write its last seconds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Trigger {
    /// Each message of this topic.
    Message(Name),
    /// A call of this service, whose request is the reason (a string), and whose reply is the path of the bag.
    Service(Name),
    /// This node has left the domain.
    LostNode(Name),
    /// This topic has had messages, but none for this time.
    MissedDeadline(Name, Duration),
}

/// The triggers of one black box.
#[derive(Default)]
pub(super) struct Triggers {
    messages: Vec<Subscriber<[u8]>>,
    services: Vec<Server<str, str>>,
    nodes: Vec<Watched>,
    deadlines: Vec<Deadline>,
    /// The call that has triggered.
    call: Option<Request<str, str>>,
}

/// A node that may leave.
struct Watched {
    name: Name,
    is_there: bool,
}

/// A topic whose messages may be missing.
struct Deadline {
    subscriber: Subscriber<[u8]>,
    period: Duration,
    /// When the next message is due at the latest. `None` before the first one, and after a miss.
    due: Option<Instant>,
}

impl Triggers {
    pub(super) fn start(
        node: &Node,
        triggers: Vec<Trigger>,
        recorder: &mut Recorder<'_>,
    ) -> Result<Self, RecordError> {
        let mut all = Self::default();
        for trigger in triggers {
            match trigger {
                Trigger::Message(topic) => {
                    let subscriber = subscribe(node, &topic)?;
                    recorder.wake_on(&subscriber).map_err(RecordError::System)?;
                    all.messages.push(subscriber);
                }
                Trigger::Service(name) => {
                    let server = node.server::<str, str>(name.as_str())?;
                    recorder.wake_on(&server).map_err(RecordError::System)?;
                    all.services.push(server);
                }
                Trigger::LostNode(name) => all.nodes.push(Watched {
                    is_there: recorder.has_node(&name),
                    name,
                }),
                Trigger::MissedDeadline(topic, period) => {
                    let subscriber = subscribe(node, &topic)?;
                    recorder.wake_on(&subscriber).map_err(RecordError::System)?;
                    all.deadlines.push(Deadline {
                        subscriber,
                        period,
                        due: None,
                    });
                }
            }
        }
        Ok(all)
    }

    /// The reason of the next trigger, if one is there.
    pub(super) fn next(&mut self, recorder: &Recorder<'_>) -> Result<Option<String>, RecordError> {
        for server in &self.services {
            match server.try_recv() {
                Ok(Some(request)) => {
                    let reason = match request.is_empty() {
                        true => format!("call of {} by {}", server.service(), request.client()),
                        false => request.to_owned(),
                    };
                    self.call = Some(request);
                    return Ok(Some(reason));
                }
                // A request that is not a string has got its answer. One that cannot be mapped ends its link alone.
                Ok(None) | Err(RecvError::Payload { .. } | RecvError::Map { .. }) => {}
                Err(error) => return Err(error.into()),
            }
        }
        for subscriber in &self.messages {
            if take_all(subscriber)? {
                return Ok(Some(format!("message of {}", subscriber.topic())));
            }
        }
        for node in &mut self.nodes {
            let is_there = recorder.has_node(&node.name);
            if std::mem::replace(&mut node.is_there, is_there) && !is_there {
                return Ok(Some(format!("lost node {}", node.name)));
            }
        }
        let now = sm2_io::clock::now();
        for deadline in &mut self.deadlines {
            if take_all(&deadline.subscriber)? {
                deadline.due = Some(now.after(deadline.period));
            } else if deadline.due.is_some_and(|it| it <= now) {
                deadline.due = None;
                let topic = deadline.subscriber.topic();
                return Ok(Some(format!("missed deadline of {topic}")));
            }
        }
        Ok(None)
    }

    /// Answers the call that has triggered, if a call has.
    pub(super) fn answer(&mut self, path: &Path) {
        if let Some(call) = self.call.take() {
            // Without its client, nobody needs the answer.
            let _ = call.reply(&path.display().to_string());
        }
    }

    /// The time when the next message of a topic is due.
    pub(super) fn deadline(&self) -> Option<Instant> {
        self.deadlines.iter().filter_map(|it| it.due).min()
    }
}

fn subscribe(node: &Node, topic: &Name) -> Result<Subscriber<[u8]>, RecordError> {
    let builder = node.subscriber_builder::<[u8]>(topic.as_str());
    // A message of any length triggers.
    Ok(builder.any_type().max_len(u64::MAX).declare()?)
}

/// Takes all messages that are there. Returns whether there was one.
fn take_all(subscriber: &Subscriber<[u8]>) -> Result<bool, RecordError> {
    let mut has_come = false;
    loop {
        match subscriber.try_recv() {
            // A message that cannot be mapped has come as well. Its link alone has ended.
            Ok(Some(_)) | Err(RecvError::Map { .. }) => has_come = true,
            Ok(None) => return Ok(has_come),
            Err(error) => return Err(error.into()),
        }
    }
}
