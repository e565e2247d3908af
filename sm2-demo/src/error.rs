//! The errors of the demos.

use std::{io, path::PathBuf};

use sm2_manager::StartError;

/// The reason why a demo failed. Each text is one line.
#[derive(Debug, thiserror::Error)]
pub enum DemoError {
    /// The output cannot be written.
    #[error("cannot write to standard output: {0}")]
    Output(io::Error),
    /// The operating system refuses something that the demo needs.
    #[error("cannot {action}: {source}")]
    System {
        /// The action that failed.
        action: &'static str,
        /// The reason of the operating system.
        r#source: io::Error,
    },
    /// The demo cannot create its private folder.
    #[error("cannot create a folder in {}: {source}", parent.display())]
    Folder {
        /// The folder that should hold the private one.
        parent: PathBuf,
        /// The reason of the operating system.
        r#source: io::Error,
    },
    /// The demo's Manager did not start.
    #[error("the demo's Manager does not start: {0}")]
    Manager(StartError),
    /// The demo's messages would not fit into memory.
    #[error(
        "messages of {size_bytes} bytes need some {needed_bytes} bytes of memory and \
         {available_bytes} are available: give a smaller --size"
    )]
    TooLarge {
        /// The length of one message.
        size_bytes: u64,
        /// The memory for all messages that are in flight at a time.
        needed_bytes: u64,
        /// The memory that the system has available.
        available_bytes: u64,
    },
    /// The run would have more messages than the demo keeps latencies for.
    #[error(
        "the demo would publish {count} messages, and {limit} is the most: lower --rate or --seconds"
    )]
    TooLong {
        /// The number of messages that the options ask for.
        count: u64,
        /// The largest number of messages.
        limit: u64,
    },
    /// The demo has to use the loopback interface, which does not work.
    #[error(
        "the demo's link is a relay on the loopback interface, since {no_namespaces}; \
         the loopback interface does not work ({source}): run `ip link set lo up`"
    )]
    Loopback {
        /// The reason why there are no network namespaces.
        no_namespaces: String,
        /// The reason of the operating system.
        r#source: io::Error,
    },
    /// A gateway of the demo did not start, or did not connect to the other one.
    #[error("the demo's gateways: {0}")]
    Gateway(String),
    /// A process of the demo failed.
    #[error("the demo's {part} failed: {reason}")]
    PartFailed {
        /// The process.
        part: String,
        /// The reason, in one line.
        reason: String,
    },
    /// A subscriber received bytes that nobody published.
    #[error(
        "{part} received {messages} damaged messages: the first is its message {message}, at byte {offset}"
    )]
    Damaged {
        /// The subscriber.
        part: String,
        /// The number of damaged messages.
        messages: u64,
        /// The count of the first damaged message among all that it received.
        message: u64,
        /// The offset of the first wrong byte in that message.
        offset: u64,
    },
    /// A subscriber received no message.
    #[error("{part} received nothing: this machine may be too busy for that rate or size")]
    NothingReceived {
        /// The subscriber.
        part: String,
    },
    /// A call of `sm2-node` failed; its error says which.
    #[error(transparent)]
    Node(Box<dyn std::error::Error + Send + Sync>),
}

impl From<io::Error> for DemoError {
    fn from(error: io::Error) -> Self {
        Self::Output(error)
    }
}

impl DemoError {
    /// Turns an error of `sm2-node` into [`DemoError::Node`].
    pub(crate) fn node(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Node(Box::new(error))
    }

    /// Turns an I/O error into [`DemoError::System`].
    pub(crate) fn system(action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::System { action, source }
    }
}
