//! Messages from the domain and for the domain.

use std::{sync::Arc, time::Duration};

use bytes::Bytes;
use sm2_node::{
    Node, Publisher, RecvError, Sample, Subscriber,
    asynchronous::{AsyncSubscriber, IntoAsync},
};
use sm2_proto::{Name, TypeId, gateway::Subject};
use tokio::task::AbortHandle;

use super::error::LocalError;
use crate::{
    channel::hub::{HubEvent, HubHandle},
    hub::{LATCHED_MAX, LocalEvent},
    names::is_remote,
    retry::until_ok,
};

/// Messages up to this size are copied, which frees their slots at once.
const COPY_MAX_BYTES: usize = 16 << 10;
/// The greatest number of samples of a subscription that are borrowed at a time.
const MAX_BORROWED: u16 = 16;
/// Longer messages are borrowed while fewer than this many are, and copied from then on. A slow peer
/// keeps what waits for it, so without copies it would use up the samples that all peers share.
const COPY_FROM_BORROWED: usize = 8;
/// Depth of subscriptions, whatever depth the peers want. Another depth would need another
/// subscriber, and messages published in between would be lost for all peers.
const DEPTH_IN: u16 = 64;
/// Depth of publishers that stand for remote ones.
const DEPTH_OUT: u16 = 64;

/// A subscription, until it is dropped.
#[derive(Debug)]
pub(super) struct Subscription(AbortHandle);

impl Drop for Subscription {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// A borrowed sample. Its slot is not written again before the sample is dropped.
struct Borrowed {
    sample: Sample<[u8]>,
    /// Shared by all borrowed samples of a subscription, which counts them.
    _counted: Arc<()>,
}

impl AsRef<[u8]> for Borrowed {
    fn as_ref(&self) -> &[u8] {
        &self.sample
    }
}

pub(super) fn declare_subscriber(
    node: &Node,
    name: &Name,
    data: &TypeId,
    max_len_bytes: u64,
) -> Result<AsyncSubscriber<[u8]>, LocalError> {
    let builder = node.subscriber_builder::<[u8]>(name.as_str());
    let subscriber: Subscriber<[u8]> = builder
        .type_id(data.clone())
        .depth(DEPTH_IN)
        .max_borrowed(MAX_BORROWED)
        .max_len(max_len_bytes)
        .declare()?;
    Ok(subscriber.into_async()?)
}

/// Forwards the messages of a subscriber to the hub.
pub(super) fn forward(
    subscriber: AsyncSubscriber<[u8]>,
    subject: Subject,
    max_len_bytes: u64,
    hub: HubHandle,
) -> Subscription {
    let task = tokio::spawn(take(subscriber, subject, max_len_bytes, hub));
    Subscription(task.abort_handle())
}

/// Forwards messages of the domain's own publishers to the hub; long ones without a copy.
async fn take(
    subscriber: AsyncSubscriber<[u8]>,
    subject: Subject,
    max_len_bytes: u64,
    hub: HubHandle,
) {
    let borrowed = Arc::new(());
    loop {
        let subscriber = &subscriber;
        let receive = || async move {
            loop {
                match subscriber.recv().await {
                    // All `MAX_BORROWED` samples are in flight; resumes with newer ones.
                    Err(RecvError::TooManyBorrowed { .. }) => {
                        tokio::time::sleep(Duration::from_millis(1)).await;
                    }
                    received => break received,
                }
            }
        };
        let report = |error: &RecvError| {
            tracing::warn!(name = %subject.name(), %error, "cannot take a message");
        };
        let sample = until_ok(receive, report).await;
        if is_remote(sample.publisher()) {
            continue;
        }
        // The subscription's own maximum is rounded up, so slightly longer messages come here. Checked before
        // any byte is read: a sparse message takes memory only as it is copied.
        if sample.len() as u64 > max_len_bytes {
            let subject = subject.clone();
            let event = LocalEvent::Refused { subject };
            if hub.send(HubEvent::Local(event)).await.is_err() {
                return;
            }
            continue;
        }
        let published_at = sample.source_time();
        // One reference is this task's own.
        let others = Arc::strong_count(&borrowed) - 1;
        let payload = match is_copied(sample.len(), others, subject.latched()) {
            true => Bytes::copy_from_slice(&sample),
            false => Bytes::from_owner(Borrowed {
                sample,
                _counted: Arc::clone(&borrowed),
            }),
        };
        let event = LocalEvent::Message {
            subject: subject.clone(),
            published_at,
            payload,
        };
        if hub.send(HubEvent::Local(event)).await.is_err() {
            return;
        }
    }
}

/// Whether a message is copied, while this number of samples is borrowed.
const fn is_copied(len: usize, borrowed: usize, latched: u16) -> bool {
    // The hub keeps latched messages, so borrowing them would use up the samples.
    len <= COPY_MAX_BYTES || borrowed >= COPY_FROM_BORROWED || latched > 0
}

/// Declares a publisher that stands for remote ones.
pub(super) fn publisher(
    node: &Node,
    name: &Name,
    data: &TypeId,
    reliable: bool,
    latched: u16,
) -> Result<Publisher<[u8]>, LocalError> {
    let builder = node.publisher_builder::<[u8]>(name.as_str());
    let builder = builder
        .type_id(data.clone())
        .depth(DEPTH_OUT)
        .latched(latched.min(LATCHED_MAX))
        .reliable(reliable)
        // A subscriber without room misses the message: it must not delay what arrives here.
        .publish_timeout(Duration::ZERO);
    Ok(builder.declare()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_messages_are_borrowed_while_few_are() {
        let long = (16 << 10) + 1;
        assert!(is_copied(0, 0, 0) && is_copied(long - 1, 0, 0));
        assert!(!is_copied(long, 0, 0) && !is_copied(long, 7, 0));
        assert!(is_copied(long, 8, 0) && is_copied(long, 0, 1));
        // A peer that keeps what it has leaves samples for the others.
        const { assert!(COPY_FROM_BORROWED < MAX_BORROWED as usize) };
    }
}
