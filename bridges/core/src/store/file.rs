//! One file of a store: the messages in MCAP, without chunks, so that each is readable as soon as it is written.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use bytes::Bytes;
use mcap::read::{LinearReader, Options};
use mcap::records::{MessageHeader, Record};
use mcap::{McapError, WriteOptions, Writer};
use sm2_proto::{Name, TypeId};

use super::error::StoreError;
use crate::spool::Id;
use crate::{Durable, Origin};

// The metadata of a channel: the parts of messages that are the same for all of them.
const TYPE: &str = "type";
const TYPE_HASH: &str = "type_hash";
const BRIDGE: &str = "bridge";
const EPOCH: &str = "epoch";
/// The high half of the numbers of messages; the low half is their `sequence`.
const NUMBER_HIGH: &str = "number_high";

/// A closed file.
#[derive(Debug)]
pub(super) struct StoreFile {
    path: PathBuf,
    first: Id,
    len: u64,
    /// How many messages have no fate yet.
    left: u64,
}

impl StoreFile {
    /// A file with `len` messages. None of them has its fate.
    pub(super) const fn new(path: PathBuf, first: Id, len: u64) -> Self {
        Self {
            path,
            first,
            len,
            left: len,
        }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) const fn first(&self) -> Id {
        self.first
    }

    pub(super) const fn has(&self, id: Id) -> bool {
        id.0 >= self.first.0 && id.0 - self.first.0 < self.len
    }

    pub(super) const fn is_done(&self) -> bool {
        self.left == 0
    }

    /// A message has its fate. Returns whether it was the last one.
    pub(super) const fn end(&mut self) -> bool {
        self.left -= 1;
        self.left == 0
    }
}

/// The newest file.
pub(super) struct Writing {
    file: StoreFile,
    writer: Writer<BufWriter<File>>,
    /// The number of each channel, by what its messages have in common.
    channels: BTreeMap<(Name, TypeId, Name, u64, u64), u16>,
    /// The length of the file up to its last whole message.
    len_bytes: u64,
    /// Those without a fate.
    messages: Vec<Option<Durable>>,
}

impl std::fmt::Debug for Writing {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Writing")
            .field("file", &self.file)
            .field("len_bytes", &self.len_bytes)
            .finish_non_exhaustive()
    }
}

impl Writing {
    pub(super) fn create(path: PathBuf, first: Id) -> Result<Self, StoreError> {
        let file = OpenOptions::new().write(true).create_new(true).open(&path);
        let file = file.map_err(StoreError::io("make", &path))?;
        let options = WriteOptions::new()
            .profile("sm2")
            .library("sm2-bridge")
            .use_chunks(false);
        let writer = options.create(BufWriter::new(file));
        let writer = writer.map_err(|error| mcap("write", &path, error))?;
        Ok(Self {
            file: StoreFile::new(path, first, 0),
            writer,
            channels: BTreeMap::new(),
            len_bytes: 0,
            messages: Vec::new(),
        })
    }

    /// The number of the next message.
    pub(super) const fn next(&self) -> Id {
        Id(self.file.first.0 + self.file.len)
    }

    pub(super) const fn len_bytes(&self) -> u64 {
        self.len_bytes
    }

    pub(super) fn append(&mut self, message: Durable) -> Result<(), StoreError> {
        let written = self
            .write(&message)
            .map_err(|error| mcap("write", &self.file.path, error));
        self.len_bytes = written?;
        self.file.len += 1;
        self.file.left += 1;
        self.messages.push(Some(message));
        Ok(())
    }

    fn write(&mut self, message: &Durable) -> Result<u64, McapError> {
        let channel_id = self.channel(message)?;
        let header = MessageHeader {
            channel_id,
            sequence: message.origin.number as u32,
            log_time: message.time,
            publish_time: message.time,
        };
        self.writer
            .write_to_known_channel(&header, &message.payload)?;
        self.writer.flush()?;
        Ok(fs::metadata(&self.file.path)?.len())
    }

    fn channel(&mut self, message: &Durable) -> Result<u16, McapError> {
        let Origin {
            bridge,
            epoch,
            number,
        } = &message.origin;
        let (topic, data, high) = (&message.topic, &message.data, number >> 32);
        let key = (topic.clone(), data.clone(), bridge.clone(), *epoch, high);
        if let Some(channel) = self.channels.get(&key) {
            return Ok(*channel);
        }
        let metadata = BTreeMap::from([
            (TYPE.to_owned(), data.name.to_string()),
            (TYPE_HASH.to_owned(), data.hash.to_string()),
            (BRIDGE.to_owned(), bridge.to_string()),
            (EPOCH.to_owned(), epoch.to_string()),
            (NUMBER_HIGH.to_owned(), high.to_string()),
        ]);
        let channel = self
            .writer
            .add_channel(0, topic.as_str(), "bytes", &metadata)?;
        self.channels.insert(key, channel);
        Ok(channel)
    }

    /// A message that has no fate yet.
    pub(super) fn get(&self, id: Id) -> Option<&Durable> {
        self.messages.get(self.index(id)?)?.as_ref()
    }

    /// Whether the file has the message, which has its fate now.
    pub(super) fn end(&mut self, id: Id) -> bool {
        let message = self.index(id).and_then(|it| self.messages.get_mut(it));
        match message {
            Some(message) => {
                self.file.left -= u64::from(message.take().is_some());
                true
            }
            None => false,
        }
    }

    fn index(&self, id: Id) -> Option<usize> {
        usize::try_from(id.0.checked_sub(self.file.first.0)?).ok()
    }

    /// Ends the file.
    pub(super) fn close(mut self) -> Result<StoreFile, StoreError> {
        match self.writer.finish() {
            Ok(_) => Ok(self.file),
            Err(_) => self.cut(),
        }
    }

    /// Ends the file behind its last whole message, where the disk did not take all that was written.
    pub(super) fn cut(self) -> Result<StoreFile, StoreError> {
        // The rest of the buffer must not follow.
        drop(self.writer.into_inner().into_parts());
        let path = &self.file.path;
        let file = OpenOptions::new().write(true).open(path);
        let cut = file.and_then(|it| it.set_len(self.len_bytes));
        cut.map_err(StoreError::io("shorten", path))?;
        Ok(self.file)
    }
}

/// The messages of a file, up to its end or its first damage.
pub(super) fn read(path: &Path) -> Result<Vec<Durable>, StoreError> {
    let bytes = Bytes::from(fs::read(path).map_err(StoreError::io("read", path))?);
    let mut messages = Vec::new();
    let Ok(reader) = LinearReader::new_with_options(&bytes, Options::IgnoreEndMagic.into()) else {
        return Ok(messages);
    };
    let mut channels = BTreeMap::new();
    for record in reader.map_while(Result::ok) {
        match record {
            Record::Channel(channel) => {
                channels.insert(channel.id, common(&channel.topic, &channel.metadata));
            }
            Record::Message { header, data } => {
                if let Some(Some((topic, data_type, origin))) = channels.get(&header.channel_id) {
                    messages.push(Durable {
                        topic: topic.clone(),
                        data: data_type.clone(),
                        origin: Origin {
                            number: origin.number | u64::from(header.sequence),
                            ..origin.clone()
                        },
                        time: header.log_time,
                        payload: Bytes::copy_from_slice(&data),
                    });
                }
            }
            _ => {}
        }
    }
    Ok(messages)
}

/// The parts that all messages of a channel have in common. `None` if no store has written it.
fn common(topic: &str, metadata: &BTreeMap<String, String>) -> Option<(Name, TypeId, Origin)> {
    let text = |key: &str| metadata.get(key);
    let number = |key: &str| text(key)?.parse::<u64>().ok();
    let name = |key: &str| Name::new(text(key)?).ok();
    let data = TypeId {
        name: name(TYPE)?,
        hash: number(TYPE_HASH)?,
    };
    let origin = Origin {
        bridge: name(BRIDGE)?,
        epoch: number(EPOCH)?,
        number: number(NUMBER_HIGH)? << 32,
    };
    Some((Name::new(topic).ok()?, data, origin))
}

pub(super) fn remove(path: &Path) -> Result<(), StoreError> {
    fs::remove_file(path).map_err(StoreError::io("remove", path))
}

fn mcap(action: &'static str, path: &Path, error: McapError) -> StoreError {
    let source = match error {
        McapError::Io(source) => source,
        other => io::Error::other(other),
    };
    StoreError::io(action, path)(source)
}
