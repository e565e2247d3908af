//! The content of a recorded file, as the reader of the crate `mcap` sees it, whichever program wrote it.

use std::{
    collections::{HashMap, HashSet},
    fs::File,
    io::Read,
    path::Path,
};

use mcap::{
    McapResult,
    records::{Record, op},
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

use crate::payload::check;

/// The messages of a file.
#[derive(Debug, Default)]
pub struct Content {
    /// The numbers of the intact messages of each topic.
    numbers: HashMap<String, HashSet<u64>>,
    /// The number of messages that differ from the published ones.
    pub torn: u64,
    /// The length of all payloads, in bytes.
    pub bytes: u64,
}

impl Content {
    /// Reads a whole file, and checks the checksums of its chunks and every byte of its messages.
    ///
    /// # Errors
    ///
    /// The file cannot be read, or is damaged.
    pub fn of(path: &Path) -> McapResult<Self> {
        let mut file = File::open(path)?;
        let options = LinearReaderOptions::default().with_validate_chunk_crcs(true);
        let mut reader = LinearReader::new_with_options(options);
        let mut content = Self::default();
        let mut topics = HashMap::new();
        while let Some(event) = reader.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(want) => {
                    let read = file.read(reader.insert(want))?;
                    reader.notify_read(read);
                }
                LinearReadEvent::Record { data, opcode } => {
                    // Other records have no messages.
                    if matches!(opcode, op::CHANNEL | op::MESSAGE) {
                        content.add(mcap::parse_record(opcode, data)?, &mut topics);
                    }
                }
            }
        }
        Ok(content)
    }

    fn add(&mut self, record: Record<'_>, topics: &mut HashMap<u16, String>) {
        match record {
            Record::Channel(channel) => {
                topics.insert(channel.id, channel.topic);
            }
            Record::Message { header, data } => {
                self.bytes += data.len() as u64;
                let topic = topics.get(&header.channel_id);
                match (topic, check(&data)) {
                    (Some(topic), Ok(header)) => {
                        let numbers = self.numbers.entry(topic.clone()).or_default();
                        numbers.insert(header.number);
                    }
                    _ => self.torn += 1,
                }
            }
            _ => {}
        }
    }

    /// How many of the messages 0 to `count` (excluded) of a topic are not in the file.
    #[must_use]
    pub fn missing(&self, topic: &str, count: u64) -> u64 {
        let found = self.numbers.get(topic);
        let found = found.map_or(0, |it| it.iter().filter(|it| **it < count).count());
        count - found as u64
    }
}
