//! Recording topics to files, and replaying them.
//!
//! A *bag* is an [MCAP](https://mcap.dev) file. Tools for MCAP read bags without SM2.
//!
//! | to | use |
//! | --- | --- |
//! | record topics of a domain | [`Recorder`], into one file ([`BagFile`]) or into a [`Folder`] |
//! | keep the last seconds when something happens | [`BlackBox`] |
//! | find the files of a bag | [`BagFiles`] |
//! | read a bag: its summary, its messages | [`Bag`], [`messages`](fn@messages) |
//! | publish the messages of one or more bags again | [`Player`] |
//! | check a bag for damage | [`check`](fn@check) |
//! | write the readable part of a damaged bag to a new file | [`recover`](fn@recover) |
//! | write chosen messages of one or more bags to a new file | [`copy`](fn@copy) |
//! | correct the times of a recording whose clock was corrected | [`restamp`](fn@restamp) |
//! | compare the payloads of two bags | [`diff`](fn@diff) |
//!
//! # The content of a bag
//!
//! | MCAP | content |
//! | --- | --- |
//! | profile | `sm2`; `ros2` if every channel has a type of ROS 2 when the first chunk is written |
//! | channel | one publisher of one topic; its metadata are those of [`Source`] |
//! | schema | the name of the type, encoding `sm2`, and the schema text (SPEC Annex A) |
//! | schema of a ROS 2 type | the name of the type, encoding `ros2msg`, and the definition |
//! | channel of a ROS 2 type | also the hash of the type, and the publisher's QoS in the form of rosbag2 |
//! | message encoding | the encoding in the schema text: `plain`, `postcard`, `json`, `cdr`; `bytes` without a text |
//! | `log_time` | the time of reception, in nanoseconds of the wall clock (of a polled topic: see below) |
//! | `publish_time` | the time of publication, in nanoseconds of the wall clock |
//! | `sequence` | the low half of the publisher's number of the message |
//! | metadata `sm2.clock` | the relation of the wall clock to the monotonic clock: [`ClockRelation`] |
//! | metadata `sm2.recorder` | the recorder of the file: [`WrittenBy`] |
//! | metadata `sm2.gap` | messages that are missing: [`Gap`] |
//! | metadata `sm2.missing` | a topic that was not recorded for a time, and the reason |
//! | metadata `sm2.not_recorded` | how many more topics were not recorded, without their names |
//! | metadata `sm2.not_repeated` | latched messages that the file should begin with, and has no room for |
//! | metadata `sm2.damaged` | a damaged part of the bag that this one was copied from |
//! | metadata `sm2.restamped` | by how many nanoseconds all times were moved |
//! | metadata `sm2.incident` | the trigger and the times of a [`BlackBox`] |
//! | metadata `sm2.channel` | the counts of one channel, at the end of a complete bag |
//!
//! Both times follow the wall clock as it was at the start of the recording, so they never step. If the wall clock
//! steps during the recording, a further `sm2.clock` has its new relation to the monotonic clock.
//!
//! Best-effort topics with 40 to 1,000 messages per second are polled every 2 ms. The `log_time` of their messages is
//! the time of publication, if that is after the last poll. So messages of several topics stay in their order.
//!
//! # Latched topics
//!
//! Each file of a folder, and each bag that begins at a time of another one, begins with the latched state as of then:
//! the messages that a subscriber gets which joins at this moment. They are *repeated*: their channel is that of their
//! publisher, with `sm2.repeated` in its metadata. Their `log_time` is that of the beginning, and their `publish_time`
//! and `sequence` are those of the original. Counts and comparisons leave them out, and a reader of several files gets
//! each message once. A recorder keeps at most a quarter of its [budget](Options::budget_bytes) for this, and fills at
//! most half of a file.
//!
//! # Bags of ROS 2
//!
//! Bags of rosbag2 and of the Python package `rosbags` are read and played as well: channels with the message encoding
//! `cdr` and the schema encoding `ros2msg`. The hash of the type is computed from its definition. Topics lose the slash
//! at their start. The publisher's node is `bag`; its QoS is reliable with a depth of 64, and the metadata
//! `offered_qos_profiles` can make it best effort or latched. A folder with `metadata.yaml` is one bag ([`BagFiles`]).
//! Files and messages that rosbag2 has compressed by zstd are read as they were before.
//!
//! # After a crash
//!
//! The recorder ends a chunk and calls `fdatasync(2)` once in each [interval](Options::sync_interval). A bag whose
//! recorder was killed has no summary, and its last chunk may be torn. [`Bag::open`] rebuilds the summary of all chunks
//! before the torn one in memory, and says so ([`Report::complete`]).
#![forbid(unsafe_code)]
#![deny(clippy::disallowed_types)]

mod attachment;
mod bag;
mod bag_files;
mod black_box;
mod checksum;
mod chunk;
mod clock;
mod content;
mod copy;
mod damaged;
mod diff;
mod error;
mod folder;
mod foreign;
#[cfg(feature = "fuzzing")]
pub mod fuzz;
mod gap;
mod incident_record;
mod index;
mod landmarks;
mod latched;
mod lengths;
mod merged;
mod messages;
mod missing;
mod names;
mod observer;
mod patterns;
mod payload;
mod player;
mod profile;
mod queue;
mod recorder;
mod recover;
mod repeated;
mod report;
mod restamp;
mod resync;
mod ros_qos;
mod rosbag2;
mod scan;
mod shift;
mod source;
mod storage;
mod summary;
mod unpacked;
mod verify;
mod writer;
mod written_by;

pub use crate::{
    bag::Bag,
    bag_files::{BagFiles, bags_in},
    black_box::{BlackBox, BlackBoxOptions, BlackBoxStep, Incident, Trigger},
    clock::{ClockRelation, MonotonicClock, WallClock},
    copy::{copy, copy_observed},
    damaged::DamagedPart,
    diff::{Comparison, Difference, diff, diff_observed},
    error::{CopyError, PlayError, ReadError, RecordError, RestampError, WriteError},
    folder::Folder,
    foreign::ForeignReason,
    gap::{Gap, GapReason},
    latched::messages,
    messages::{BagMessage, Filter, Messages},
    missing::MissingTopic,
    names::{create_first, numbered},
    observer::Observer,
    patterns::{Pattern, PatternError, TopicPatterns},
    player::{
        LeftOut, PlayCommand, PlayCommandError, PlayControl, PlayOptions, PlayReport, PlayStatus,
        PlayedTopic, Player,
    },
    recorder::{Options, Progress, Recorder, Split, Step, Topics},
    recover::{recover, recover_observed},
    report::{Report, TopicReport, TopicType},
    restamp::{Restamped, restamp},
    rosbag2::Rosbag2Error,
    source::Source,
    storage::{BagFile, FreeBytes, Storage, SyncWork},
    verify::{Damage, Verdict, check},
    writer::Compression,
    written_by::WrittenBy,
};
