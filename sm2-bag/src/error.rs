//! The errors of the library.

use std::io;
use std::path::{Path, PathBuf};

use mcap::McapError;
use sm2_node::domain::QueryError;
use sm2_node::{ConnectError, DeclareError, PublishError, RecvError, WaitError};
use sm2_proto::lockstep::TooManyRounds;

use crate::damaged::DamagedPart;
use crate::foreign::ForeignReason;
use crate::rosbag2::Rosbag2Error;

/// Why a recording did not start, or ended.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// A topic cannot be subscribed to.
    #[error(transparent)]
    Declare(#[from] DeclareError),
    /// The Manager does not describe the domain.
    #[error(transparent)]
    Query(#[from] QueryError),
    /// A message cannot be received.
    #[error(transparent)]
    Receive(#[from] RecvError),
    /// Waiting failed.
    #[error(transparent)]
    Wait(#[from] WaitError),
    /// The operating system refuses something that the recorder needs.
    #[error("cannot start to record: {0}")]
    System(io::Error),
    /// Another recorder uses the ring.
    #[error("another recorder uses this ring: give each one a folder of its own (see --ring)")]
    RingInUse,
    /// The disk has less free space than the recording has to leave. The bag is complete up to then.
    #[error(
        "the recording has ended, because the disk is nearly full (see --min-free); what was recorded is complete"
    )]
    DiskFull,
    /// The file cannot be written. Everything before the last interval can be read: see [`recover`](fn@crate::recover).
    #[error("cannot write the bag: {0}; the messages before can be read: see `sm2 bag recover`")]
    Write(WriteError),
}

/// Why a bag cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The operating system refuses to write.
    #[error(transparent)]
    Io(io::Error),
    /// MCAP has no room for the record, such as a 65,537th channel.
    #[error(transparent)]
    Format(McapError),
    /// The thread that writes the file panicked.
    #[error("the thread that writes the file panicked")]
    Panicked,
}

impl From<McapError> for WriteError {
    fn from(error: McapError) -> Self {
        match error {
            McapError::Io(source) => Self::Io(source),
            error => Self::Format(error),
        }
    }
}

impl From<io::Error> for WriteError {
    fn from(source: io::Error) -> Self {
        Self::Io(source)
    }
}

/// Why a bag cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The operating system refuses to read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The reason of the operating system.
        r#source: io::Error,
    },
    /// The file does not begin like an MCAP file.
    #[error("{} is not an MCAP file", path.display())]
    NotABag {
        /// The file.
        path: PathBuf,
    },
    /// The description of a bag of rosbag2 is of no use.
    #[error("cannot read the bag that {} describes: {reason}", path.display())]
    Rosbag2 {
        /// The description.
        path: PathBuf,
        /// The fault.
        reason: Rosbag2Error,
    },
    /// The folder has no bag.
    #[error("{} has no bag: no file that ends in .mcap, and no metadata.yaml", path.display())]
    NoBag {
        /// The folder.
        path: PathBuf,
    },
    /// There is no room for the content of a file that is compressed as a whole.
    #[error(
        "there is no room in {} for the content of {}: set TMPDIR to a folder with more room, or decompress it \
         yourself",
        folder.display(),
        path.display()
    )]
    NoRoom {
        /// The file.
        path: PathBuf,
        /// The folder for its content.
        folder: PathBuf,
    },
    /// A part of the file is damaged. The records behind it can be read.
    #[error("{} is damaged ({part}): `sm2 bag recover` copies the rest", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The part.
        part: DamagedPart,
    },
    /// The [`Observer`](crate::Observer) ended the work.
    #[error("the work with the bag was ended")]
    Stopped,
}

impl ReadError {
    /// The error of an operating system that cannot read a file.
    pub(crate) fn io(path: &Path, error: McapError) -> Self {
        let path = path.to_owned();
        let source = match error {
            McapError::Io(source) => source,
            error => io::Error::other(error),
        };
        Self::Io { path, source }
    }

    /// The error for the part of a file with this place and length in bytes.
    pub(crate) fn damaged(path: &Path, part: (u64, u64), error: McapError) -> Self {
        if is_of_system(&error) {
            return Self::io(path, error);
        }
        Self::Damaged {
            path: path.to_owned(),
            part: DamagedPart::new(part, &error),
        }
    }
}

/// Whether the operating system has failed. The libraries for compressed chunks have errors of the same type.
pub(crate) fn is_of_system(error: &McapError) -> bool {
    matches!(error, McapError::Io(source) if source.raw_os_error().is_some())
}

/// Why the messages of bags were not copied to a new bag.
#[derive(Debug, thiserror::Error)]
pub enum CopyError {
    /// A bag cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// No bag has a topic of the filter.
    #[error("no bag has topic {topic:?}: see `sm2 bag info`")]
    NoTopic {
        /// The topic, or the pattern.
        topic: String,
    },
    /// The new bag cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The new bag.
        path: PathBuf,
        /// The reason.
        r#source: WriteError,
    },
}

/// Why the times of a recording were not corrected.
#[derive(Debug, thiserror::Error)]
pub enum RestampError {
    /// The bag has no relation of the clocks, so no recorder of SM2 has written it.
    #[error(
        "the bag does not tell how the wall clock and the monotonic clock were related (metadata record sm2.clock), \
         so its times cannot be corrected: no recorder of SM2 wrote it"
    )]
    NoRelation,
    /// The wall clock was not corrected while the recorder ran.
    #[error("the wall clock was not corrected during the recording, so its times stay as they are")]
    NoStep,
    /// The relations are of several recordings.
    #[error(
        "the bag has several recordings, each with a clock of its own: correct each one before they are merged"
    )]
    SeveralRecordings,
    /// The messages cannot be copied.
    #[error(transparent)]
    Copy(#[from] CopyError),
}

/// Why a bag is not played.
#[derive(Debug, thiserror::Error)]
pub enum PlayError {
    /// The bag cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The bag has a channel that another program recorded, and SM2 cannot publish its messages.
    #[error(
        "{} has messages of topic {topic:?} that SM2 cannot publish ({reason}): play other topics only",
        path.display()
    )]
    Foreign {
        /// The bag.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The reason.
        reason: Box<ForeignReason>,
    },
    /// The bag has no message of the chosen topics and times.
    #[error("{} has no message to play: see `sm2 bag info`", path.display())]
    Empty {
        /// The bag.
        path: PathBuf,
    },
    /// A node for a recorded publisher cannot connect.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// A topic cannot be published.
    #[error(transparent)]
    Declare(#[from] DeclareError),
    /// A message cannot be published.
    #[error(transparent)]
    Publish(#[from] PublishError),
    /// Waiting failed.
    #[error(transparent)]
    Wait(#[from] WaitError),
    /// The calls of members of the lockstep cannot be received.
    #[error(transparent)]
    Receive(#[from] RecvError),
    /// A step of the lockstep does not end.
    #[error(transparent)]
    Lockstep(#[from] TooManyRounds),
}
