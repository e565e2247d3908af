//! The errors of all commands. Each text is one line: what failed, where, and what to do.

use std::{
    io,
    net::SocketAddr,
    path::{Path, PathBuf},
};

use nix::libc;
use sm2_bag::{CopyError, PlayError, ReadError, RecordError, RestampError};
use sm2_demo::DemoError;
use sm2_io::DomainSocketError;
use sm2_manager::PolicyFileError;
use sm2_node::domain::{QueryError, ReloadError};
use sm2_node::schema::SchemaError;
use sm2_node::{
    CallError, ConnectError, DeclareError, PublishError, RecvError, StoreError, WaitError,
};
use sm2_proto::{Kind, Name, text::Counted};
use sm2_ros_idl::FolderError;

use crate::{
    decode::CodecError,
    ended::WRONG_USAGE,
    interrupt::Stopped,
    new_robot::NewError,
    param::ParamError,
    size::{MESSAGE_MAX_BYTES, Size},
    up::UpError,
};

/// An error that ends a command. The command prints the text after `sm2: `.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CliError {
    /// No Manager listens at the domain's socket.
    #[error(
        "no Manager answers at {}: start one with `sm2 manager{option}`, or name another domain",
        path.display()
    )]
    NoManager {
        /// The path of the socket.
        path: PathBuf,
        /// The option that makes `sm2 manager` use the same socket.
        option: String,
    },
    /// The path of the socket is not a Manager's socket.
    #[error("{} is not the socket of a Manager: check --socket and $SM2_SOCKET", path.display())]
    NotASocket {
        /// The path of the socket.
        path: PathBuf,
    },
    /// The socket belongs to another user.
    #[error(
        "this user may not connect to the Manager at {} ({source}): have its operator allow it \
         (`sm2 manager --socket-mode 660` and a common group), or start one of your own \
         (`sm2 manager --socket PATH`)",
        path.display()
    )]
    MayNotConnect {
        /// The path of the socket.
        path: PathBuf,
        /// The reason of the operating system.
        r#source: io::Error,
    },
    /// A signal came before the command had printed anything.
    #[error("stopped")]
    Stopped(Stopped),
    /// The domain has no topic, service, node or interface of this name.
    #[error("this domain has no {what} {name}{hint}")]
    Unknown {
        /// The kind of thing that was searched.
        what: &'static str,
        /// The name that was given.
        name: String,
        /// A similar name with punctuation, or an empty text.
        hint: String,
    },
    /// The node has no topic or service of this name.
    #[error("node {node} has no interface {name}{found}")]
    NotOfNode {
        /// The name of the node.
        node: String,
        /// The name that was given.
        name: String,
        /// The interfaces that may be meant, with punctuation, or an empty text.
        found: String,
    },
    /// A node without interfaces cannot be linked with anything.
    #[error("node {node} has declared no interface: there is nothing to link")]
    NoInterfaces {
        /// Its name.
        node: String,
    },
    /// A name stands for several interfaces.
    #[error("{text} may be {candidates}: name one of them as NODE:NAME")]
    Ambiguous {
        /// The name that was given.
        text: String,
        /// The interfaces that the name may stand for.
        candidates: String,
    },
    /// There is no such command.
    #[error("there is no command `sm2 {command}`: see `sm2 --help`")]
    NoSuchCommand {
        /// The words of the command.
        command: String,
    },
    /// The given JSON is not a message of the type.
    #[error("this is not a message of type {data}: {reason}")]
    Encode {
        /// The type.
        data: String,
        /// The fault.
        reason: String,
    },
    /// The schema of a type is a definition of ROS 2 that is wrong.
    #[error("messages of type {data} cannot be read or written by their definition: {reason}")]
    Definition {
        /// The type.
        data: String,
        /// The fault.
        reason: CodecError,
    },
    /// `--type` of a subscriber names a type that nothing defines.
    #[error(
        "there is no definition of {name}: name a built-in type or one of ROS 2's common interfaces, or give the \
         folder of its package with --definitions"
    )]
    NoDefinition {
        /// The name of the type.
        name: Name,
    },
    /// A folder of `--definitions` cannot be read.
    #[error("cannot read the definitions of --definitions: {0}")]
    Definitions(FolderError),
    /// The given value is not JSON.
    #[error(
        "the value is not JSON ({0}): quote it for the shell, such as '{{\"x\": 1}}' or '\"text\"'"
    )]
    Json(serde_json::Error),
    /// A value needs a schema.
    #[error("{0}")]
    NoSchema(String),
    /// `--type` has another hash than `--schema`.
    #[error(
        "--schema has the hash {hash:016x}, but --type has {given:016x}: omit the hash of --type"
    )]
    SchemaHash {
        /// The hash in `--type`.
        given: u64,
        /// The hash of `--schema`.
        hash: u64,
    },
    /// The Manager refuses a schema.
    #[error(transparent)]
    Schema(#[from] SchemaError),
    /// A call failed.
    #[error(transparent)]
    Call(#[from] CallError),
    /// No server came in time.
    #[error("service {service} has no server{hint}")]
    NoServer {
        /// The service.
        service: String,
        /// A similar name with punctuation, or an empty text.
        hint: String,
    },
    /// An interactive command has no terminal.
    #[error("top needs a terminal: use `sm2 top --once`, `sm2 snapshot` or `sm2 topic hz` instead")]
    NoTerminal,
    /// The address of `--listen` cannot be used.
    #[error(
        "cannot listen on {address}: {source}: name another address with --listen, or port 0 for a free port"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The reason of the operating system.
        r#source: io::Error,
    },
    /// A program that is installed on its own cannot be started.
    #[error(
        "cannot start {program} ({source}): install it (`cargo install --path {program}` in the repository)"
    )]
    NotInstalled {
        /// The program, and the folder of the repository that has it.
        program: &'static str,
        /// The reason of the operating system.
        r#source: io::Error,
    },
    /// The domain's socket cannot be named.
    #[error(transparent)]
    DomainSocket(#[from] DomainSocketError),
    /// The Manager refuses the command's node.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The Manager refuses the command's interface.
    #[error(transparent)]
    Declare(#[from] DeclareError),
    /// A wait for counterparts failed.
    #[error(transparent)]
    Wait(#[from] WaitError),
    /// A message cannot be published.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// There is no memory for a message.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Messages cannot be received.
    #[error(transparent)]
    Receive(#[from] RecvError),
    /// The Manager does not answer a question about the domain.
    #[error(transparent)]
    Query(#[from] QueryError),
    /// The Manager does not apply its access policy again.
    #[error(transparent)]
    Reload(#[from] ReloadError),
    /// A file is not an access policy.
    #[error(transparent)]
    Policy(#[from] PolicyFileError),
    /// The parameters of a node cannot be read or set.
    #[error(transparent)]
    Param(#[from] ParamError),
    /// The folder of a robot cannot be made.
    #[error(transparent)]
    New(#[from] NewError),
    /// A robot cannot be started.
    #[error(transparent)]
    Up(#[from] UpError),
    /// A file or folder cannot be used.
    #[error("cannot {action} {}: {source}{}", path.display(), advice(source))]
    File {
        /// The action that failed.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The reason of the operating system.
        r#source: io::Error,
    },
    /// A recording failed.
    #[error("{}: {source}", path.display())]
    Record {
        /// The bag.
        path: PathBuf,
        /// The reason.
        r#source: RecordError,
    },
    /// The messages around a trigger were not written.
    #[error("{} was not written, after a trigger by {reason}; the ring has its messages", path.display())]
    Incident {
        /// The bag.
        path: PathBuf,
        /// The trigger.
        reason: String,
    },
    /// A reliable topic that is not recorded.
    #[error("--reliable {topic} is not among the topics to record: name it there, too")]
    NotRecorded {
        /// The topic.
        topic: String,
    },
    /// `sm2 play control` has a factor for another command than `rate`.
    #[error("only `sm2 play control rate` takes a factor")]
    NotForRate,
    /// A bag cannot be read.
    #[error(transparent)]
    ReadBag(#[from] ReadError),
    /// The messages of bags cannot be copied to a new bag.
    #[error(transparent)]
    CopyBag(#[from] CopyError),
    /// The times of a recording cannot be corrected.
    #[error(transparent)]
    RestampBag(RestampError),
    /// A topic, or a pattern for topics, that fits nothing in the bags.
    #[error("no bag has a topic {pattern:?}{hint} (`sm2 bag info` lists them)")]
    NotInBag {
        /// The name or the pattern.
        pattern: String,
        /// A similar name.
        hint: String,
    },
    /// A bag cannot be played.
    #[error(transparent)]
    Play(#[from] PlayError),
    /// The folder to publish has no files.
    #[error("folder {} holds no file to publish: put some in, or name another", path.display())]
    EmptyFolder {
        /// The folder.
        path: PathBuf,
    },
    /// `--loop` has no message to repeat.
    #[error("there is no message to publish with --loop: the input of --from is empty")]
    NothingToLoop,
    /// `--loop` with standard input, which cannot be read twice.
    #[error("standard input cannot be read again: use --loop with a file or folder")]
    LoopOfInput,
    /// No interface came whose counters could be read.
    #[error(
        "no {kind} of {topic} in {seconds:.1} s, so there is nothing to measure: start one, or raise --timeout"
    )]
    NothingToMeasure {
        /// The topic.
        topic: Name,
        /// The kind of interface that keeps the counters.
        kind: Kind,
        /// The time that was waited.
        seconds: f64,
    },
    /// Reliable subscribers do not take messages.
    #[error(
        "subscribers that want every message left {} for {seconds} s: are they stopped, or too slow?",
        Counted::new(*messages, "message")
    )]
    TooSlow {
        /// The number of messages, on all links together.
        messages: u64,
        /// The time that was waited.
        seconds: u64,
    },
    /// Some reliable subscribers accept no messages of this length.
    #[error(
        "subscribers that want every message missed {}, longer than they accept: raise their max_len, \
         or split the messages",
        Counted::new(*messages, "message")
    )]
    NotAccepted {
        /// The number of messages, on all links together.
        messages: u64,
    },
    /// A message in the input is too long.
    #[error(
        "{} holds a message longer than {}: split it with --chunk",
        path.display(),
        Size(MESSAGE_MAX_BYTES)
    )]
    MessageTooLong {
        /// The input.
        path: PathBuf,
    },
    /// The folder has messages of an earlier run.
    #[error("folder {} already holds messages ({found}): name an empty folder", path.display())]
    FolderInUse {
        /// The folder.
        path: PathBuf,
        /// One of these messages.
        found: String,
    },
    /// Writing to standard output failed.
    #[error("cannot write to standard output: {0}")]
    Output(io::Error),
    /// The demo failed.
    #[error(transparent)]
    Demo(DemoError),
    /// The operating system refuses something that the command needs.
    #[error("cannot {action}: {source}{}", advice(source))]
    System {
        /// The action that failed.
        action: &'static str,
        /// The reason of the operating system.
        r#source: io::Error,
    },
}

impl CliError {
    pub(crate) fn file(action: &'static str, path: &Path, source: io::Error) -> Self {
        let path = path.to_owned();
        Self::File {
            action,
            path,
            source,
        }
    }

    pub(crate) fn system(action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::System { action, source }
    }

    /// The exit status: 2 for a wrong command line, 1 for any other error.
    pub(crate) fn status(&self) -> u8 {
        match self {
            Self::Stopped(signal) => signal.status(),
            Self::Param(error) => error.status(),
            Self::Up(error) => error.status(),
            Self::LoopOfInput
            | Self::Demo(DemoError::TooLong { .. })
            | Self::NoSuchCommand { .. }
            | Self::NotRecorded { .. }
            | Self::NotForRate
            | Self::NoTerminal
            | Self::Json(_)
            | Self::SchemaHash { .. }
            | Self::DomainSocket(DomainSocketError::DomainName { .. }) => WRONG_USAGE,
            _ => 1,
        }
    }

    /// Whether the reader of standard output has ended, as in `… | head`. That is not a failure.
    pub(crate) fn is_broken_pipe(&self) -> bool {
        matches!(self, Self::Output(error) if error.kind() == io::ErrorKind::BrokenPipe)
    }
}

/// Maps the demo's I/O errors to those of all commands, so that their texts are the same.
impl From<RestampError> for CliError {
    fn from(error: RestampError) -> Self {
        match error {
            RestampError::Copy(error) => Self::CopyBag(error),
            error => Self::RestampBag(error),
        }
    }
}

impl From<DemoError> for CliError {
    fn from(error: DemoError) -> Self {
        match error {
            DemoError::Output(source) => Self::Output(source),
            DemoError::System { action, source } => Self::System { action, source },
            DemoError::Folder { parent, source } => {
                Self::file("create a folder in", &parent, source)
            }
            error => Self::Demo(error),
        }
    }
}

/// The remedy for an error of the file system.
fn advice(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound => ": check the path",
        io::ErrorKind::PermissionDenied => ": give this user the permission, or use another path",
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            ": free some space, or name a folder elsewhere"
        }
        io::ErrorKind::ReadOnlyFilesystem => ": name a folder elsewhere",
        _ if error.raw_os_error() == Some(libc::EMFILE) => ": raise the limit (ulimit -n)",
        _ => "",
    }
}
