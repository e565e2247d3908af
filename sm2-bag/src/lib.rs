//! Recording topics to files, and replaying them.
//!
//! A *bag* is an [MCAP](https://mcap.dev) file. Tools for MCAP read bags without SM2.
//!
//! | to | use |
//! | --- | --- |
//! | record topics of a domain | [`Recorder`], into one file ([`BagFile`]) or into a [`Folder`] |
//! | keep the last seconds when something happens | [`BlackBox`] |
//! | read a bag: its summary, its messages | [`Bag`] |
//! | publish the messages of one or more bags again | [`Player`] |
//! | check a bag for damage | [`check`](fn@check) |
//! | write the readable part of a damaged bag to a new file | [`recover`](fn@recover) |
//! | write chosen messages of one or more bags to a new file | [`copy`](fn@copy) |
//! | compare the payloads of two bags | [`diff`](fn@diff) |
//!
//! # The content of a bag
//!
//! | MCAP | content |
//! | --- | --- |
//! | profile | `sm2` |
//! | channel | one publisher of one topic; its metadata are those of [`Source`] |
//! | schema | the name of the type, encoding `sm2`, and the schema text (SPEC Annex A) |
//! | message encoding | the encoding in the schema text: `plain`, `postcard`, `json`; `bytes` without a text |
//! | `log_time` | the time of reception, in nanoseconds of the wall clock |
//! | `publish_time` | the time of publication, in nanoseconds of the wall clock |
//! | `sequence` | the low half of the publisher's number of the message |
//! | metadata `sm2.clock` | the relation of the wall clock to the monotonic clock: [`ClockRelation`] |
//! | metadata `sm2.gap` | messages that are missing: [`Gap`] |
//! | metadata `sm2.incident` | the trigger and the times of a [`BlackBox`] |
//! | metadata `sm2.channel` | the counts of one channel, at the end of a complete bag |
//!
//! Both times follow the wall clock as it was at the start of the recording, so they never step. If the wall clock
//! steps during the recording, a further `sm2.clock` has its new relation to the monotonic clock.
//!
//! # After a crash
//!
//! The recorder ends a chunk and calls `fdatasync(2)` once in each [interval](Options::sync_interval). A bag whose
//! recorder was killed has no summary, and its last chunk may be torn. [`Bag::open`] rebuilds the summary of all chunks
//! before the torn one in memory, and says so ([`Report::complete`]).
#![forbid(unsafe_code)]
#![deny(clippy::disallowed_types)]

mod bag;
mod black_box;
mod chunk;
mod clock;
mod copy;
mod diff;
mod error;
mod folder;
mod gap;
mod merged;
mod messages;
mod player;
mod queue;
mod recorder;
mod recover;
mod report;
mod scan;
mod source;
mod storage;
mod verify;
mod writer;

pub use crate::{
    bag::Bag,
    black_box::{BlackBox, BlackBoxOptions, BlackBoxStep, Incident, Trigger},
    clock::ClockRelation,
    copy::copy,
    diff::{Difference, diff},
    error::{CopyError, PlayError, ReadError, RecordError, WriteError},
    folder::Folder,
    gap::{Gap, GapReason},
    messages::{BagMessage, Filter, Messages},
    player::{PlayOptions, PlayReport, PlayedTopic, Player},
    recorder::{Options, Progress, Recorder, Split, Step, Topics},
    recover::recover,
    report::{Report, TopicReport},
    source::Source,
    storage::{BagFile, Storage},
    verify::{Damage, Verdict, check},
    writer::Compression,
};
