//! Everything that can end a command badly, each as one line: what, where, what to do.

use std::{
    io,
    path::{Path, PathBuf},
};

use nix::libc;
use sm2_demo::DemoError;
use sm2_io::DomainSocketError;
use sm2_node::domain::QueryError;
use sm2_node::schema::SchemaError;
use sm2_node::{
    CallError, ConnectError, DeclareError, PublishError, RecvError, StoreError, WaitError,
};
use sm2_proto::{Kind, Name, text::Counted};

use crate::{
    ended::WRONG_USAGE,
    interrupt::Stopped,
    size::{MESSAGE_MAX_BYTES, Size},
};

/// Why a command failed. Its text is what `sm2: …` says.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CliError {
    /// Nobody listens at the domain's socket.
    #[error(
        "no Manager answers at {}: start one with `sm2 manager{option}`, or name another domain",
        path.display()
    )]
    NoManager {
        /// Where it should be.
        path: PathBuf,
        /// How the command was told so, as `sm2 manager` takes it.
        option: String,
    },
    /// Something else is where the Manager's socket should be.
    #[error("{} is not the socket of a Manager: check --socket and $SM2_SOCKET", path.display())]
    NotASocket {
        /// Where.
        path: PathBuf,
    },
    /// The socket belongs to somebody else.
    #[error(
        "this user may not connect to the Manager at {} ({source}): have its operator allow it \
         (`sm2 manager --socket-mode 660` and a common group), or start one of your own \
         (`sm2 manager --socket PATH`)",
        path.display()
    )]
    MayNotConnect {
        /// Where.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// A signal came before the command had begun.
    #[error("stopped")]
    Stopped(Stopped),
    /// Nothing in the domain has that name.
    #[error("this domain has no {what} {name}{hint}")]
    Unknown {
        /// What was looked for.
        what: &'static str,
        /// Its name.
        name: String,
        /// What may be meant instead, with its punctuation; or nothing.
        hint: String,
    },
    /// A node without interfaces cannot be linked with anything.
    #[error("node {node} has declared no interface: there is nothing to link")]
    NoInterfaces {
        /// Its name.
        node: String,
    },
    /// A name stands for several things.
    #[error("{text} may be {candidates}: name one of them as NODE:TOPIC")]
    Ambiguous {
        /// What was given.
        text: String,
        /// What it may be.
        candidates: String,
    },
    /// There is no such command.
    #[error("there is no command `sm2 {command}`: see `sm2 --help`")]
    NoSuchCommand {
        /// Its words.
        command: String,
    },
    /// A message that a person gave is none of the type.
    #[error("this is no message of type {data}: {reason}")]
    Encode {
        /// The type.
        data: String,
        /// What is wrong.
        reason: String,
    },
    /// A message that a person gave is no JSON.
    #[error(
        "the value is no JSON ({0}): quote it for the shell, such as '{{\"x\": 1}}' or '\"text\"'"
    )]
    Json(#[source] serde_json::Error),
    /// A value needs a schema.
    #[error("{0}")]
    NoSchema(String),
    /// A hash that is not that of the schema beside it.
    #[error("--schema has the hash {hash:016x}, but --type says {given:016x}: leave that out")]
    SchemaHash {
        /// What --type says.
        given: u64,
        /// What it is.
        hash: u64,
    },
    /// The Manager does not take a schema.
    #[error(transparent)]
    Schema(#[from] SchemaError),
    /// A call has no reply.
    #[error(transparent)]
    Call(#[from] CallError),
    /// No server came in time.
    #[error("service {service} has no server{hint}")]
    NoServer {
        /// Which service.
        service: String,
        /// What may be meant instead, with its punctuation; or nothing.
        hint: String,
    },
    /// Interactive, without anybody to interact with.
    #[error("top needs a terminal: use `sm2 top --once`, `sm2 snapshot` or `sm2 topic hz` instead")]
    NoTerminal,
    /// The domain's socket cannot be named.
    #[error(transparent)]
    DomainSocket(#[from] DomainSocketError),
    /// The Manager does not take the command's node.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The Manager does not take the command's interface.
    #[error(transparent)]
    Declare(#[from] DeclareError),
    /// The command's counterparts do not come.
    #[error(transparent)]
    Wait(#[from] WaitError),
    /// A message cannot be published.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// A message has no memory.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Messages cannot be received.
    #[error(transparent)]
    Receive(#[from] RecvError),
    /// The Manager does not say what there is.
    #[error(transparent)]
    Query(#[from] QueryError),
    /// A file or folder cannot be used.
    #[error("cannot {action} {}: {source}{}", path.display(), advice(source))]
    File {
        /// What was tried.
        action: &'static str,
        /// With what.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// Nothing to publish.
    #[error("folder {} holds no file to publish: put some in, or name another", path.display())]
    EmptyFolder {
        /// Which folder.
        path: PathBuf,
    },
    /// Nothing to publish, again and again.
    #[error("there is no message to publish with --loop: what --from names is empty")]
    NothingToLoop,
    /// What cannot be read twice.
    #[error("standard input cannot be read again: use --loop with a file or folder")]
    LoopOfInput,
    /// Nobody came whose counters could be read.
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
    /// Subscribers that want every message do not take them.
    #[error(
        "subscribers that want every message left {} for {seconds} s: are they stopped, or too slow?",
        Counted::new(*messages, "message")
    )]
    TooSlow {
        /// How many, on all links together.
        messages: u64,
        /// How long was waited.
        seconds: u64,
    },
    /// A message that is read does not end.
    #[error(
        "{} holds a message longer than {}: split it with --chunk",
        path.display(),
        Size(MESSAGE_MAX_BYTES)
    )]
    MessageTooLong {
        /// Where it is.
        path: PathBuf,
    },
    /// Messages would mix with older ones.
    #[error("folder {} holds messages already ({found}): name an empty one", path.display())]
    FolderInUse {
        /// Which folder.
        path: PathBuf,
        /// A file in it.
        found: String,
    },
    /// Standard output does not take more.
    #[error("cannot write to standard output: {0}")]
    Output(#[source] io::Error),
    /// The demo failed.
    #[error(transparent)]
    Demo(DemoError),
    /// The operating system refuses what the command needs.
    #[error("cannot {action}: {source}{}", advice(source))]
    System {
        /// What was tried.
        action: &'static str,
        /// What it said.
        source: io::Error,
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

    /// The exit status: whether the command line is wrong, or what it asks for failed.
    pub(crate) fn status(&self) -> u8 {
        match self {
            Self::Stopped(signal) => signal.status(),
            Self::LoopOfInput
            | Self::Demo(DemoError::TooLong { .. })
            | Self::NoSuchCommand { .. }
            | Self::NoTerminal
            | Self::Json(_)
            | Self::SchemaHash { .. }
            | Self::DomainSocket(DomainSocketError::DomainName { .. }) => WRONG_USAGE,
            _ => 1,
        }
    }

    /// Whether it only says that nobody reads our output any more, which is no failure: `… | head`.
    pub(crate) fn is_broken_pipe(&self) -> bool {
        matches!(self, Self::Output(error) if error.kind() == io::ErrorKind::BrokenPipe)
    }
}

/// Errors that every command can have get the texts that they have elsewhere.
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

/// What a person can do about an error of the file system.
fn advice(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound => ": check the path",
        io::ErrorKind::PermissionDenied => ": give this user the right to, or take another",
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            ": free some space, or name a folder elsewhere"
        }
        io::ErrorKind::ReadOnlyFilesystem => ": name a folder elsewhere",
        _ if error.raw_os_error() == Some(libc::EMFILE) => ": raise the limit (ulimit -n)",
        _ => "",
    }
}
