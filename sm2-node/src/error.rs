//! What can go wrong, one enumeration for each thing that a program does.
//!
//! Three kinds of wrong are never mixed: what the other side of a link or the Manager did
//! against the specification ends that link or session and is logged with its rule and
//! clause (`tracing`, level `warn`); what this program asked for and cannot have
//! is one of these errors; what the operating system refuses is their `Io`.

use std::io;
use std::path::PathBuf;

use sm2_io::DomainSocketError;
use sm2_io::counters::CounterError;
use sm2_proto::domain::Nonsense;
use sm2_proto::limits::MESSAGE_MAX;
use sm2_proto::node::End;
use sm2_proto::schema::ParseError;
use sm2_proto::{Kind, Name, NameError, QosError, Quota, Refusal, TypeId};

use crate::{EncodeError, PayloadError};

/// Why a node did not get a session with its Manager.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConnectError {
    /// The node's name is none.
    #[error("node name {name:?}: {reason}")]
    Name {
        /// The name as it was given.
        name: String,
        /// The rule that it breaks.
        reason: NameError,
    },
    /// The domain or its socket cannot be named.
    #[error(transparent)]
    DomainSocket(#[from] DomainSocketError),
    /// The node's own Manager cannot run, and cannot stand by either.
    #[cfg(feature = "embedded-manager")]
    #[error(transparent)]
    Manager(#[from] sm2_manager::StartError),
    /// Nobody listens at the domain's socket.
    #[error(
        "no Manager at {path:?} ({source}): start one with 'sm2 manager', or choose another domain (SM2_DOMAIN, SM2_SOCKET)"
    )]
    NoManager {
        /// The socket's path.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Another node of the domain has this name.
    #[error("another node of this domain is named {name}: choose another name, or stop that node")]
    NameTaken {
        /// The name.
        name: Name,
    },
    /// The Manager refused for another reason: version or quota.
    #[error("the Manager refused: {0}")]
    Refused(Refusal),
    /// The Manager hung up, or broke the protocol.
    #[error("the Manager ended the session: {0}")]
    Ended(End),
    /// The Manager did not answer in time.
    #[error("the Manager at {path:?} did not answer in time: is it stopped?")]
    TimedOut {
        /// The socket's path.
        path: PathBuf,
    },
    /// The operating system refused.
    #[error("cannot reach the Manager at {path:?}: {source}")]
    Io {
        /// The socket's path.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// Why an interface was not declared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DeclareError {
    /// The topic or service has a name that is none.
    #[error("{kind} name {name:?}: {reason}")]
    Name {
        /// What was to be declared.
        kind: Kind,
        /// The name as it was given.
        name: String,
        /// The rule that it breaks.
        reason: NameError,
    },
    /// A value of the quality of service is out of its range.
    #[error(transparent)]
    Qos(#[from] QosError),
    /// The topic carries messages of another type (SM2-IFC-005).
    #[error(
        "topic {topic} carries {theirs}, but this {kind} was declared with {ours}: use the same type, or another topic"
    )]
    TypeMismatch {
        /// The topic.
        topic: Name,
        /// What was to be declared.
        kind: Kind,
        /// The type of this declaration.
        ours: TypeId,
        /// The type in use.
        theirs: TypeId,
    },
    /// The service has another pair of types (SM2-IFC-005).
    #[error(
        "service {service} takes {} and replies {}, but this {kind} was declared with {} and {}: use the same types, or another service",
        theirs.0, theirs.1, ours.0, ours.1
    )]
    ServiceMismatch {
        /// The service.
        service: Name,
        /// What was to be declared.
        kind: Kind,
        /// Request and reply of this declaration.
        ours: Box<(TypeId, TypeId)>,
        /// Request and reply in use.
        theirs: Box<(TypeId, TypeId)>,
    },
    /// Memory is to be reserved, but it is not known how much.
    #[error(
        "{name} was not declared: slots, prefault and mlock are about the memory that max_len reserves; say max_len as well"
    )]
    NoMaxLen {
        /// The topic.
        name: Name,
    },
    /// Memory is to be reserved for messages that have memory of their own.
    #[error(
        "{name} was not declared: each sealed message needs new memory, so none can be reserved with max_len; leave out one of the two"
    )]
    ReservedSealed {
        /// The topic.
        name: Name,
    },
    /// No segment holds as much as is to be reserved (SM2-SEG-003).
    #[error(
        "{name} was not declared: {slots} messages of {max_len} bytes are more than one segment holds (65,536 slots, 2^41 bytes); reserve less"
    )]
    ReserveTooMuch {
        /// The topic.
        name: Name,
        /// The length of the longest message, in bytes.
        max_len: usize,
        /// How many messages.
        slots: u32,
    },
    /// The operating system refused the memory that is to be reserved.
    #[error(
        "{name} was not declared, since memory for {slots} messages of {max_len} bytes cannot be had ({source}): reserve less"
    )]
    Reserve {
        /// The topic.
        name: Name,
        /// The length of the longest message, in bytes.
        max_len: usize,
        /// How many messages.
        slots: u32,
        /// What the system said.
        source: io::Error,
    },
    /// The operating system does not lock the memory that is reserved.
    #[error(
        "{name} was not declared, since memory for {slots} messages of {max_len} bytes cannot be locked ({source}): RLIMIT_MEMLOCK is {limit_bytes} bytes; raise it (ulimit -l, LimitMEMLOCK=), reserve less, or leave out mlock"
    )]
    Lock {
        /// The topic.
        name: Name,
        /// The length of the longest message, in bytes.
        max_len: usize,
        /// How many messages.
        slots: u32,
        /// `RLIMIT_MEMLOCK`, in bytes.
        limit_bytes: u64,
        /// What the system said.
        source: io::Error,
    },
    /// A quota of the Manager is used up (SM2-IFC-006).
    #[error(
        "{name} was not declared, since the quota of {limit} {quota} is used up: close some, or have the operator raise it"
    )]
    Quota {
        /// The topic or service.
        name: Name,
        /// Which quota.
        quota: Quota,
        /// How many it allows.
        limit: u32,
    },
    /// The Manager refused for a reason that does not belong to a declaration.
    #[error("the Manager refused {name}: {reason}")]
    Refused {
        /// The topic or service.
        name: Name,
        /// Its reason.
        reason: Refusal,
    },
    /// The Manager did not answer in time, though it is there.
    #[error("{name} was not declared, since the Manager did not answer in time: is it stopped?")]
    TimedOut {
        /// The topic or service.
        name: Name,
    },
    /// The Manager is gone, and no other came in time. Links that are open go on, and the
    /// node goes on looking for a Manager.
    #[error(
        "{name} was not declared, since the Manager is gone ({end}) and no other came in time: start one with 'sm2 manager', or raise the node's timeout"
    )]
    ManagerGone {
        /// The topic or service.
        name: Name,
        /// How the last session ended.
        end: End,
    },
    /// The operating system refused.
    #[error("cannot wait for the Manager's answer: {0}")]
    Io(#[source] io::Error),
}

/// Why waiting for other interfaces ended without them.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WaitError {
    /// The time is over.
    #[error(
        "{found} of {wanted} {kind}s are linked when the time is over: are they running, in this domain{}?",
        matching(*kind)
    )]
    TimedOut {
        /// What was waited for.
        kind: Kind,
        /// How many were linked.
        found: usize,
        /// How many were wanted.
        wanted: usize,
    },
    /// The time is over, and there is no Manager that could link any.
    #[error(
        "{found} of {wanted} {kind}s are linked when the time is over, and the Manager is gone ({end}): start one with 'sm2 manager'"
    )]
    ManagerGone {
        /// What was waited for.
        kind: Kind,
        /// How many were linked.
        found: usize,
        /// How many were wanted.
        wanted: usize,
        /// How the last session ended.
        end: End,
    },
    /// The time is over, and there is no Manager.
    #[error(
        "this node has no Manager when the time is over{}: start one with 'sm2 manager'",
        end.map(|end| format!(" ({end})")).unwrap_or_default()
    )]
    NoManager {
        /// How the last session ended; `None` if there is one that is not answered yet.
        end: Option<End>,
    },
    /// The operating system refused.
    #[error("cannot wait: {0}")]
    Io(#[source] io::Error),
}

/// What else may be wrong with interfaces of this kind that are not linked. Services have no
/// quality of service that could differ.
const fn matching(kind: Kind) -> &'static str {
    match kind {
        Kind::Publisher | Kind::Subscriber => ", with a matching QoS",
        Kind::Server | Kind::Client => "",
    }
}

/// Why a message was not stored, so that nobody got it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// The value has no encoding.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// The type does not fit the memory of a loan.
    #[error(transparent)]
    Layout(PayloadError),
    /// The message is longer than any may be.
    #[error("a message of {len} bytes: {MESSAGE_MAX} are possible")]
    TooLong {
        /// Its length in bytes.
        len: u64,
    },
    /// All memory that the pool may have holds messages that somebody still needs.
    #[error(
        "no slot for {len} bytes: all {limit_bytes} bytes of this pool are in use; raise pool_limit or slots, or have receivers give samples back sooner"
    )]
    PoolFull {
        /// The length of the message, in bytes.
        len: u64,
        /// The limit that was set, in bytes.
        limit_bytes: u64,
    },
    /// The operating system refused.
    #[error("no shared memory for a message: {0}")]
    Io(#[from] io::Error),
}

/// Why a publication failed. That a reliable subscriber missed a message is not an error of
/// the call, since the others have it: see [`Published`](crate::Published).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PublishError {
    /// The message was not stored, so nobody got it.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// By [`Published::complete`](crate::Published::complete): some links missed the message.
    #[error(
        "{missed} reliable subscribers had no room until the deadline; {links} subscribers have the message"
    )]
    DeadlineExceeded {
        /// How many links have it.
        links: usize,
        /// How many missed it.
        missed: usize,
    },
    /// The operating system refused. The message went to those links that had room.
    #[error("cannot wait for room: {0}")]
    Io(#[source] io::Error),
}

/// Why no message was received.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecvError {
    /// The program holds as many messages of this link as it may (SM2-MSG-005), and no other
    /// link has one.
    #[error(
        "{held} samples of node {publisher} are held, which is max_borrowed: drop some, or raise max_borrowed"
    )]
    TooManyBorrowed {
        /// How many are held.
        held: u16,
        /// The node whose messages they are.
        publisher: Name,
    },
    /// What came is not a message of the type. It counts as received.
    #[error("node {publisher} sent what it did not declare: {reason}")]
    Payload {
        /// The node that sent it.
        publisher: Name,
        /// What is wrong with it.
        reason: PayloadError,
    },
    /// The message's memory cannot be mapped; its link was closed.
    #[error(
        "a message of node {publisher} cannot be mapped ({source}): its link was closed; is there memory left?"
    )]
    Map {
        /// The node that sent it.
        publisher: Name,
        /// What the system said.
        source: io::Error,
    },
    /// The operating system refused.
    #[error("cannot wait for a message: {0}")]
    Io(#[source] io::Error),
}

/// Why a call has no reply.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CallError {
    /// No server of this service is linked.
    #[error("service {service} has no server: start one, or wait with wait_for_servers")]
    NoServer {
        /// The service.
        service: Name,
    },
    /// The server ended before it replied (SM2-SRV-005).
    #[error("the server of {service} ended before it replied")]
    ServerGone {
        /// The service.
        service: Name,
    },
    /// The deadline passed. A reply that still comes is dropped.
    #[error("{service} did not reply until the deadline")]
    DeadlineExceeded {
        /// The service.
        service: Name,
    },
    /// The call was cancelled.
    #[error("the call of {service} was cancelled")]
    Cancelled {
        /// The service.
        service: Name,
    },
    /// The server could not do it.
    #[error("the server of {service} failed: {reason}")]
    Failed {
        /// The service.
        service: Name,
        /// What it says.
        reason: String,
    },
    /// The program holds as many calls and replies of each server as it may.
    #[error(
        "{limit} calls and replies of {service} are held for each server: wait for some, or raise max_borrowed"
    )]
    TooManyCalls {
        /// The service.
        service: Name,
        /// How many it may hold.
        limit: usize,
    },
    /// The request was not stored.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The reply is not a message of its type.
    #[error("the server of {service} sent what it did not declare: {reason}")]
    Payload {
        /// The service.
        service: Name,
        /// What is wrong with it.
        reason: PayloadError,
    },
    /// The operating system refused.
    #[error("the call of {service} failed: {source}")]
    Io {
        /// The service.
        service: Name,
        /// What the system said.
        source: io::Error,
    },
}

/// Why a reply did not go out. The client has another answer then, or needs none.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReplyError {
    /// The reply was not stored. The client is told that the call failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The client is gone.
    #[error("client {client} is gone")]
    ClientGone {
        /// The client's node.
        client: Name,
    },
}

/// Why the Manager's answer to a question is not known.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum QueryError {
    /// The Manager is gone, and no other came in time.
    #[error("the Manager is gone ({0}) and no other came in time: start one with 'sm2 manager'")]
    ManagerGone(End),
    /// The Manager did not answer in time, or the domain changed faster than it could be read.
    #[error("the Manager did not answer in time: is it stopped?")]
    TimedOut,
    /// What the Manager said about the domain is none that obeys the specification.
    #[error(transparent)]
    Nonsense(#[from] Nonsense),
    /// The counters that a node shows are none.
    #[error(transparent)]
    Counters(#[from] CounterError),
    /// The operating system refused.
    #[error("cannot wait for the Manager: {0}")]
    Io(#[source] io::Error),
}

/// Why a schema text was not registered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SchemaError {
    /// It is no schema text (SM2-TYP-001).
    #[error("the schema text of {data} is none: {reason}")]
    Text {
        /// The type.
        data: TypeId,
        /// What is wrong with it.
        reason: ParseError,
    },
    /// It is that of another type (SM2-SCH-001).
    #[error("the schema text of {data} has the hash {found:016x}: it describes another type")]
    Hash {
        /// The type.
        data: TypeId,
        /// The hash of the text.
        found: u64,
    },
}
