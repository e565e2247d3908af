//! Errors of the data plane: publishing, receiving, and calls.

use std::io;

use sm2_proto::Name;
use sm2_proto::limits::MESSAGE_MAX;
use sm2_proto::text::Counted;

use crate::{EncodeError, PayloadError};

/// A message was not stored, so no receiver got it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// The value cannot be encoded.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// The type does not fit into the memory of a loan.
    #[error(transparent)]
    Layout(PayloadError),
    /// The message exceeds the protocol's limit.
    #[error("the message has {len} bytes, but at most {MESSAGE_MAX} are possible: split it")]
    TooLong {
        /// The length of the message, in bytes.
        len: u64,
    },
    /// Every slot that the pool may have holds a message that is still in use.
    #[error(
        "no slot for {len} bytes: the reserved slots and pool_limit ({limit_bytes} bytes) leave no \
         room; raise pool_limit or slots, or have receivers drop their samples sooner"
    )]
    PoolFull {
        /// The length of the message, in bytes.
        len: u64,
        /// The limit of the pool, in bytes.
        limit_bytes: u64,
    },
    /// The operating system has no shared memory for the message.
    #[error(
        "cannot allocate shared memory for a message ({0}): free memory, or raise the limit of open \
         files (ulimit -n)"
    )]
    Io(io::Error),
}

/// A publication failed. A reliable subscriber that missed the message is not an error of the call,
/// because the other subscribers have it: see [`Published`](crate::Published).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PublishError {
    /// The message was not stored, so no subscriber got it.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Some reliable links missed the message. Only
    /// [`Published::complete`](crate::Published::complete) returns this error.
    #[error(
        "{} had no room and missed the message, {} got it: \
         raise publish_timeout, or the depth of the reliable subscribers",
        Counted::new(*missed as u64, "reliable subscriber"),
        Counted::new(*links as u64, "subscriber")
    )]
    DeadlineExceeded {
        /// The number of links that have the message.
        links: usize,
        /// The number of links that missed it.
        missed: usize,
    },
    /// Some reliable links missed the message, and it is longer than some subscribers accept. Only
    /// [`Published::complete`](crate::Published::complete) returns this error.
    #[error(
        "{} missed the message, {} got it, and {} accept none of this length: \
         raise max_len of these subscribers, or split the message",
        Counted::new(*missed as u64, "reliable subscriber"),
        Counted::new(*links as u64, "subscriber"),
        Counted::new(*too_long as u64, "subscriber")
    )]
    TooLong {
        /// The number of links that have the message.
        links: usize,
        /// The number of reliable links that missed it.
        missed: usize,
        /// The number of links whose subscriber accepts no message of this length.
        too_long: usize,
    },
    /// The program requested a shutdown while the call waited for room. The message went to the links
    /// that had room.
    #[error("the program requested a shutdown while reliable links had no room")]
    Shutdown,
    /// Waiting for room failed. The message went to the links that had room.
    #[error("cannot wait for room in reliable links: {0}")]
    Io(io::Error),
}

/// No message was received.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecvError {
    /// The program holds `max_borrowed` samples of this link (SM2-MSG-005), and no other link has
    /// a message.
    #[error(
        "this program holds {} of node {publisher}, as many as max_borrowed allows: \
         drop some, or raise max_borrowed",
        Counted::new(u64::from(*held), "message")
    )]
    TooManyBorrowed {
        /// The number of samples held.
        held: u16,
        /// The node that published them.
        publisher: Name,
    },
    /// The payload is not a value of the declared type. The message counts as received.
    #[error("node {publisher} sent a message that is not of its declared type: {reason}")]
    Payload {
        /// The node that sent it.
        publisher: Name,
        /// The error in the payload.
        reason: PayloadError,
    },
    /// This process is short of something that mapping the memory of a message needs. The message is lost, and the next
    /// one may be received.
    #[error("a message of node {publisher} could not be mapped ({source}): is there memory left?")]
    Map {
        /// The node that sent it.
        publisher: Name,
        /// The error of the operating system.
        r#source: io::Error,
    },
    /// The program requested a shutdown: see [`Shutdown`](crate::Shutdown).
    #[error("the wait for a message ended because the program requested a shutdown")]
    Shutdown,
    /// Polling the links failed.
    #[error("cannot wait for a message: {0}")]
    Io(io::Error),
}

/// A call has no reply.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CallError {
    /// No server of this service is linked.
    #[error("service {service} has no server: start one, or wait with wait_for_servers")]
    NoServer {
        /// The service.
        service: Name,
    },
    /// The server ended before it replied (SM2-SRV-004).
    #[error("the server of {service} ended before it replied: call again if that is safe")]
    ServerGone {
        /// The service.
        service: Name,
    },
    /// The deadline passed. A later reply is dropped.
    #[error("{service} did not reply before the deadline: is its server busy or stopped?")]
    DeadlineExceeded {
        /// The service.
        service: Name,
    },
    /// A callback of an executor waits for the reply of a server that only the same executor serves, after this
    /// callback has ended. The request is cancelled, so the server does not get it.
    #[error(
        "{service} is served by the executor whose callback waits for its reply, and only after that callback: use \
         Client::send with Group::on_reply, or serve it in another executor, or in another group of one with several \
         threads"
    )]
    OwnExecutor {
        /// The service.
        service: Name,
    },
    /// The program cancelled the call.
    #[error("this program cancelled its call of {service}")]
    Cancelled {
        /// The service.
        service: Name,
    },
    /// The server replied that the request failed.
    #[error("the server of {service} failed: {reason}")]
    Failed {
        /// The service.
        service: Name,
        /// The text that the server sent.
        reason: String,
    },
    /// Each server has as many calls in flight and replies held as the client allows.
    #[error(
        "each server of {service} already has {limit} calls in flight or replies held, which is \
         max_borrowed: wait for replies and drop them, or raise max_borrowed"
    )]
    TooManyCalls {
        /// The service.
        service: Name,
        /// The limit for each server.
        limit: usize,
    },
    /// The request is longer than every linked server accepts (SM2-SRV-006).
    #[error(
        "the request has {len} bytes, but no server of {service} accepts more than {max_len}: \
         raise max_len of the server, or split the request"
    )]
    TooLong {
        /// The service.
        service: Name,
        /// The length of the request, in bytes.
        len: u64,
        /// The greatest length that a linked server accepts, in bytes.
        max_len: u64,
    },
    /// The request was not stored.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The payload of the reply is not a value of the declared type.
    #[error("the server of {service} sent a reply that is not of its declared type: {reason}")]
    Payload {
        /// The service.
        service: Name,
        /// The error in the payload.
        reason: PayloadError,
    },
    /// This process is short of something that mapping the memory of the reply needs.
    #[error("the reply of {service} could not be mapped ({source}): is there memory left?")]
    Map {
        /// The service.
        service: Name,
        /// The error of the operating system.
        r#source: io::Error,
    },
    /// The program requested a shutdown before the reply came. The call is cancelled.
    #[error("the call of {service} ended because the program requested a shutdown")]
    Shutdown {
        /// The service.
        service: Name,
    },
    /// Waiting for the server failed.
    #[error("cannot wait for the reply of {service}: {source}")]
    Io {
        /// The service.
        service: Name,
        /// The error of the operating system.
        r#source: io::Error,
    },
}

/// A reply was not sent. The client is told that the call failed, or is gone.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReplyError {
    /// The reply was not stored. The client is told that the call failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The reply is longer than the client accepts. The client is told that the call failed
    /// (SM2-SRV-007).
    #[error(
        "the reply has {len} bytes, but client {client} accepts at most {max_len}: \
         raise max_len of the client, or split the reply"
    )]
    TooLong {
        /// The client's node.
        client: Name,
        /// The length of the reply, in bytes.
        len: u64,
        /// The greatest length that the client accepts, in bytes.
        max_len: u64,
    },
    /// The client is gone.
    #[error("the reply was not sent: client {client} is gone")]
    ClientGone {
        /// The client's node.
        client: Name,
    },
}
