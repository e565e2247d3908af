//! Messages from the domain, and for it.

use std::time::Duration;

use bytes::Bytes;
use sm2_node::{
    Node, Publisher, RecvError, Sample, Subscriber,
    asynchronous::{AsyncSubscriber, IntoAsync},
};
use sm2_proto::{Name, TypeId, gateway::Subject};
use tokio::task::AbortHandle;

use crate::{
    channel::hub::{HubEvent, HubHandle},
    hub::{LATCHED_MAX, LocalEvent},
    names::is_remote,
};

/// Shorter messages are copied: their slots are free again at once.
const COPIED_BYTES: usize = 16 << 10;
/// How many longer ones are held until they have arrived, or newer ones took their place.
const HELD: u16 = 16;
/// How many messages wait for the gateway, whatever its peers want: with another depth it would be
/// another subscriber, and what is published meanwhile would be lost for all of them.
const WAITING: u16 = 64;
/// How many messages a publisher that stands for a remote one keeps for a slow subscriber.
const DEPTH: u16 = 64;

/// A subscription, until it is dropped.
#[derive(Debug)]
pub(super) struct Subscription(AbortHandle);

impl Drop for Subscription {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Memory of the domain that nobody writes to as long as it is held.
struct Held(Sample<[u8]>);

impl AsRef<[u8]> for Held {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

pub(super) fn subscribe(
    node: &Node,
    subject: &Subject,
    name: &Name,
    data: &TypeId,
    hub: HubHandle,
) -> Result<Subscription, String> {
    let builder = node.subscriber_builder::<[u8]>(name.as_str());
    let subscriber: Subscriber<[u8]> = builder
        .type_id(data.clone())
        .depth(WAITING)
        .max_borrowed(HELD)
        .declare()
        .map_err(|error| error.to_string())?;
    let subscriber = subscriber.into_async().map_err(|error| error.to_string())?;
    let task = tokio::spawn(take(subscriber, subject.clone(), hub));
    Ok(Subscription(task.abort_handle()))
}

/// Hands on what the domain's own publishers publish, without a copy.
async fn take(subscriber: AsyncSubscriber<[u8]>, subject: Subject, hub: HubHandle) {
    loop {
        let sample = match subscriber.recv().await {
            Ok(sample) => sample,
            // As many as may be are under way: the next ones are newer.
            Err(RecvError::TooManyBorrowed { .. }) => {
                tokio::time::sleep(Duration::from_millis(1)).await;
                continue;
            }
            Err(error) => {
                tracing::warn!(name = %subject.name(), %error, "a message was not taken");
                continue;
            }
        };
        if is_remote(sample.publisher()) {
            continue;
        }
        let published = sample.source_time();
        // What is latched is kept for long.
        let payload = match sample.len() <= COPIED_BYTES || subject.latched() > 0 {
            true => Bytes::copy_from_slice(&sample),
            false => Bytes::from_owner(Held(sample)),
        };
        let event = LocalEvent::Message {
            subject: subject.clone(),
            published,
            payload,
        };
        if hub.send(HubEvent::Local(event)).await.is_err() {
            return;
        }
    }
}

/// A publisher that stands for remote ones.
pub(super) fn publisher(
    node: &Node,
    name: &Name,
    data: &TypeId,
    reliable: bool,
    latched: u16,
) -> Result<Publisher<[u8]>, String> {
    let builder = node.publisher_builder::<[u8]>(name.as_str());
    let builder = builder
        .type_id(data.clone())
        .depth(DEPTH)
        .latched(latched.min(LATCHED_MAX))
        .reliable(reliable)
        // A subscriber without room misses the message: it must not delay what arrives here.
        .publish_timeout(Duration::ZERO);
    builder.declare().map_err(|error| error.to_string())
}
