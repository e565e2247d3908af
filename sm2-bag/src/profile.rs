//! The profile of a bag: a word in its header that tells other programs which records to expect.

use mcap::Channel;

use crate::source::{MESSAGE_ENCODING_CDR, ROS_SCHEMA_ENCODING, Source};

/// The profile of a bag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Profile {
    /// A bag with any types of SM2.
    Sm2,
    /// MCAP's profile for ROS 2: every channel has messages in CDR and a definition of ROS 2.
    Ros2,
}

impl Profile {
    /// The profile of a bag with these channels.
    pub(crate) fn of_channels<'a>(channels: impl Iterator<Item = &'a Channel<'static>>) -> Self {
        Self::of(channels.map(|it| {
            let schema = it.schema.as_deref();
            it.message_encoding == MESSAGE_ENCODING_CDR
                && schema.is_some_and(|it| it.encoding == ROS_SCHEMA_ENCODING)
        }))
    }

    /// The profile of a bag with the channels of these publishers.
    pub(crate) fn of_sources<'a>(sources: impl Iterator<Item = &'a Source>) -> Self {
        Self::of(sources.map(Source::is_ros))
    }

    /// A bag without a channel is one of SM2.
    fn of(mut are_ros: impl Iterator<Item = bool>) -> Self {
        match are_ros.next() {
            Some(true) if are_ros.all(|it| it) => Self::Ros2,
            _ => Self::Sm2,
        }
    }

    /// The name in the header.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Sm2 => "sm2",
            Self::Ros2 => "ros2",
        }
    }

    /// The library in the header. The headers of both profiles have the same length, so that one can replace the other
    /// in memory: the space makes up for the shorter name.
    pub(crate) const fn library(self) -> &'static str {
        match self {
            Self::Sm2 => concat!("sm2-bag/", env!("CARGO_PKG_VERSION"), " "),
            Self::Ros2 => concat!("sm2-bag/", env!("CARGO_PKG_VERSION")),
        }
    }
}
