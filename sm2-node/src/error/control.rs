//! Errors of the control plane: connecting, declaring, waiting for links, and queries.

use std::io;
use std::path::PathBuf;

use sm2_io::DomainSocketError;
use sm2_io::counters::CounterError;
use sm2_proto::control::PolicyProblem;
use sm2_proto::domain::BrokenAnswer;
use sm2_proto::node::End;
use sm2_proto::schema::ParseError;
use sm2_proto::{Kind, Name, NameError, QosError, Quota, Refusal, TypeId};

/// A node could not connect to its Manager.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConnectError {
    /// The node's name is not legal (SM2-NAM-001).
    #[error("node name {name:?}: {reason}")]
    Name {
        /// The name as the program gave it.
        name: String,
        /// The rule that it breaks.
        reason: NameError,
    },
    /// The domain's name or socket path is not usable.
    #[error(transparent)]
    DomainSocket(#[from] DomainSocketError),
    /// The embedded Manager can neither start nor stand by.
    #[cfg(feature = "embedded-manager")]
    #[error(transparent)]
    Manager(#[from] sm2_manager::StartError),
    /// No process listens at the domain's socket.
    #[error(
        "no Manager at {path:?} ({source}): start one with 'sm2 manager', \
         or choose another domain (SM2_DOMAIN, SM2_SOCKET)"
    )]
    NoManager {
        /// The socket's path.
        path: PathBuf,
        /// The error of the operating system.
        r#source: io::Error,
    },
    /// Another node of the domain has this name.
    #[error("another node of this domain is named {name}: choose another name, or stop that node")]
    NameTaken {
        /// The name.
        name: Name,
    },
    /// The Manager refused the session: it speaks another version, or a quota is used up.
    #[error("the Manager refused a session: {0}")]
    Refused(Refusal),
    /// The session ended before the Manager granted it.
    #[error(
        "the Manager ended the session before it accepted this node ({0}): see the Manager's log, then \
         connect again"
    )]
    Ended(End),
    /// The Manager did not answer within the node's timeout.
    #[error(
        "the Manager at {path:?} did not answer in time: check it with 'sm2 doctor'; if it is only \
         slow, raise the node's manager_timeout"
    )]
    TimedOut {
        /// The socket's path.
        path: PathBuf,
    },
    /// The node's background thread cannot be started.
    #[error(
        "cannot start the node's background thread ({0}): raise the limit of threads (ulimit -u), or drive the \
         node by your own calls (NodeBuilder::background)"
    )]
    BackgroundThread(io::Error),
    /// The program requested a shutdown before the Manager had answered.
    #[error("the program requested a shutdown before the Manager had answered")]
    Shutdown,
    /// The connection to the Manager's socket failed.
    #[error("cannot connect to the Manager at {path:?}: {source}")]
    Io {
        /// The socket's path.
        path: PathBuf,
        /// The error of the operating system.
        r#source: io::Error,
    },
}

/// An interface was not declared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DeclareError {
    /// The name of the topic or service is not legal (SM2-NAM-001).
    #[error("{} name {name:?}: {reason}", named(*kind))]
    Name {
        /// The kind of interface.
        kind: Kind,
        /// The name as the program gave it.
        name: String,
        /// The rule that it breaks.
        reason: NameError,
    },
    /// A QoS value is out of its range (SM2-FRM-003).
    #[error(transparent)]
    Qos(#[from] QosError),
    /// The topic carries messages of another type (SM2-IFC-005).
    #[error(
        "topic {topic} carries {theirs}, but this {kind} was declared with {ours}: \
         use the same type, or another topic"
    )]
    TypeMismatch {
        /// The topic.
        topic: Name,
        /// The kind of interface.
        kind: Kind,
        /// The type of this declaration.
        ours: TypeId,
        /// The type in use.
        theirs: TypeId,
    },
    /// The service has another pair of types (SM2-IFC-005).
    #[error(
        "service {service} takes {} and replies {}, but this {kind} was declared with {} and {}: \
         use the same types, or another service",
        theirs.0, theirs.1, ours.0, ours.1
    )]
    ServiceMismatch {
        /// The service.
        service: Name,
        /// The kind of interface.
        kind: Kind,
        /// Request and reply of this declaration.
        ours: Box<(TypeId, TypeId)>,
        /// Request and reply in use.
        theirs: Box<(TypeId, TypeId)>,
    },
    /// Memory is to be reserved, but its size is not given.
    #[error(
        "{name} was not declared: slots, prefault and mlock apply to the memory that max_len \
         reserves; set max_len as well"
    )]
    NoMaxLen {
        /// The topic.
        name: Name,
    },
    /// Memory is to be reserved for sealed messages, but each of these needs a file of its own.
    #[error(
        "{name} was not declared: each sealed message needs new memory, so max_len cannot \
         reserve any; leave out sealed or max_len"
    )]
    ReservedSealed {
        /// The topic.
        name: Name,
    },
    /// The reservation does not fit into one segment (SM2-SEG-003).
    #[error(
        "{name} was not declared: {slots} messages of {max_len} bytes do not fit into one segment \
         (65,536 slots, 2^41 bytes); reserve less"
    )]
    ReserveTooMuch {
        /// The topic.
        name: Name,
        /// The length of the longest message, in bytes.
        max_len: usize,
        /// The number of messages.
        slots: u32,
    },
    /// The memory to be reserved could not be allocated.
    #[error(
        "{name} was not declared: memory for {slots} messages of {max_len} bytes could not be \
         allocated ({source}); reserve less"
    )]
    Reserve {
        /// The topic.
        name: Name,
        /// The length of the longest message, in bytes.
        max_len: usize,
        /// The number of messages.
        slots: u32,
        /// The error of the operating system.
        r#source: io::Error,
    },
    /// The reserved memory could not be locked.
    #[error(
        "{name} was not declared: memory for {slots} messages of {max_len} bytes could not be \
         locked ({source}); RLIMIT_MEMLOCK is {limit_bytes} bytes: raise it (ulimit -l, \
         LimitMEMLOCK=), reserve less, or leave out mlock"
    )]
    Lock {
        /// The topic.
        name: Name,
        /// The length of the longest message, in bytes.
        max_len: usize,
        /// The number of messages.
        slots: u32,
        /// `RLIMIT_MEMLOCK`, in bytes.
        limit_bytes: u64,
        /// The error of the operating system.
        r#source: io::Error,
    },
    /// A quota of the Manager is used up (SM2-IFC-006).
    #[error(
        "{name} was not declared: the quota of {limit} {quota} is used up; close some{}",
        quota.remedy()
    )]
    Quota {
        /// The topic or service.
        name: Name,
        /// The quota.
        quota: Quota,
        /// The limit that it sets.
        limit: u32,
    },
    /// The Manager gave a reason that does not apply to a declaration (a name or a version).
    #[error("{name} was not declared: the Manager refused it ({reason})")]
    Refused {
        /// The topic or service.
        name: Name,
        /// The reason that the Manager gave.
        reason: Refusal,
    },
    /// The Manager is connected, but did not answer within the node's timeout.
    #[error(
        "{name} was not declared: the Manager did not answer in time; check it with 'sm2 doctor', \
         or raise the node's manager_timeout"
    )]
    TimedOut {
        /// The topic or service.
        name: Name,
    },
    /// The Manager is gone, and no other one took over within the node's timeout. Open links
    /// stay, and the node keeps looking for a Manager.
    #[error(
        "{name} was not declared: the last session ended ({end}), and no Manager has accepted this \
         node since; start one with 'sm2 manager', or see this node's log for a refusal"
    )]
    ManagerGone {
        /// The topic or service.
        name: Name,
        /// Why the last session ended.
        end: End,
    },
    /// The program requested a shutdown before the Manager had answered.
    #[error("{name} was not declared: the program requested a shutdown")]
    Shutdown {
        /// The topic or service.
        name: Name,
    },
    /// Polling the node's descriptors failed.
    #[error("cannot wait for the Manager's answer: {0}")]
    Io(io::Error),
}

/// A wait ended without its result: for links, for the Manager, for an event, or for a source of a
/// [`WaitSet`](crate::WaitSet).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WaitError {
    /// The timeout expired with fewer links than wanted.
    #[error(
        "timed out with {found} of {wanted} {kind}s linked: are they running, in this domain{}? \
         'sm2 why' explains missing links",
        matching(*kind)
    )]
    TimedOut {
        /// The kind of interface on the other side.
        kind: Kind,
        /// The number of links.
        found: usize,
        /// The number that was wanted.
        wanted: usize,
    },
    /// The timeout expired while no Manager was connected that could have made links.
    #[error(
        "timed out with {found} of {wanted} {kind}s linked; the last session ended ({end}), and no \
         Manager has accepted this node since: start one with 'sm2 manager', or see this node's log \
         for a refusal"
    )]
    ManagerGone {
        /// The kind of interface on the other side.
        kind: Kind,
        /// The number of links.
        found: usize,
        /// The number that was wanted.
        wanted: usize,
        /// Why the last session ended.
        end: End,
    },
    /// The timeout expired before the node had a session with a Manager.
    #[error(
        "timed out before a Manager accepted this node{}: start one with 'sm2 manager', or see this \
         node's log for a refusal",
        end.map(|end| format!(" ({end})")).unwrap_or_default()
    )]
    NoManager {
        /// Why the last session ended; `None` while a Manager has not answered the greeting yet.
        end: Option<End>,
    },
    /// The program requested a shutdown: see [`Shutdown`](crate::Shutdown).
    #[error("the wait ended because the program requested a shutdown")]
    Shutdown,
    /// Polling descriptors failed.
    #[error("cannot wait: {0}")]
    Io(io::Error),
}

/// The noun for the name of such an interface: publishers and subscribers are declared with a topic.
const fn named(kind: Kind) -> &'static str {
    match kind {
        Kind::Publisher | Kind::Subscriber => "topic",
        Kind::Server | Kind::Client => "service",
    }
}

/// A hint for interfaces of this kind: those of a topic may also differ in QoS.
const fn matching(kind: Kind) -> &'static str {
    match kind {
        Kind::Publisher | Kind::Subscriber => ", with a matching QoS",
        Kind::Server | Kind::Client => "",
    }
}

/// A query to the Manager has no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum QueryError {
    /// The Manager is gone, and no other one took over in time.
    #[error(
        "the last session ended ({0}), and no Manager has accepted this node since: \
         start one with 'sm2 manager', or see this node's log for a refusal"
    )]
    ManagerGone(End),
    /// The Manager did not answer in time, or the domain changed faster than it could be read.
    #[error(
        "the Manager did not answer in time: check it with 'sm2 doctor', or raise \
         the node's manager_timeout"
    )]
    TimedOut,
    /// The Manager's answer describes a domain that breaks the specification.
    #[error(transparent)]
    BrokenAnswer(#[from] BrokenAnswer),
    /// The file of a node's counters is not legal.
    #[error(transparent)]
    Counters(#[from] CounterError),
    /// The program requested a shutdown before the Manager had answered.
    #[error("the program requested a shutdown before the Manager had answered")]
    Shutdown,
    /// Polling the session failed.
    #[error("cannot wait for the Manager's answer: {0}")]
    Io(io::Error),
}

/// The Manager did not apply the access policy of its domain again.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReloadError {
    /// Only the Manager's user and root may ask.
    #[error(
        "only the Manager's user and root may have the access policy read again: run this command as \
         one of them"
    )]
    NotPermitted,
    /// The domain had no policy before, and has none now.
    #[error(
        "this domain has no access policy: start its Manager with --policy, or put the file beside its \
         socket, with .policy after its name"
    )]
    NoPolicy,
    /// The policy cannot be used. The one before stays in force.
    #[error("the access policy before stays in force: {}", printable(text))]
    Unusable {
        /// The kind of problem.
        problem: PolicyProblem,
        /// The problem, in the Manager's words.
        text: String,
    },
    /// The Manager did not answer.
    #[error(transparent)]
    Query(#[from] QueryError),
}

/// Replaces characters that would control a terminal.
fn printable(text: &str) -> String {
    let replaced = |it: char| if it.is_control() { ' ' } else { it };
    text.chars().map(replaced).collect()
}

/// A schema text was not registered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SchemaError {
    /// The text does not follow the grammar of schema texts (SM2-TYP-001).
    #[error("the schema text of {data} is malformed: {reason}")]
    Text {
        /// The type.
        data: TypeId,
        /// The first error in the text.
        reason: ParseError,
    },
    /// The text describes another type (SM2-SCH-001).
    #[error(
        "the schema text of {data} has the hash {found:016x}: it describes another type; \
         pass the text of {data}"
    )]
    Hash {
        /// The type.
        data: TypeId,
        /// The hash of the text.
        found: u64,
    },
}
