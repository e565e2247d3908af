//! A file that the writer of the crate `mcap` writes, as a program without SM2's recorder would use it.
//!
//! All options have their defaults, chunks of 768 KiB among them, except that nothing is compressed. The file is a
//! `BufWriter<File>`, which is synchronized once, at the end.

use std::{
    collections::BTreeMap,
    fmt::Display,
    fs::File,
    io::{BufWriter, Write},
    path::Path,
    time::{SystemTime, UNIX_EPOCH},
};

use mcap::{WriteOptions, Writer, records::MessageHeader};

use super::contract::PeerError;

/// A file with one channel for each topic.
pub struct McapFile {
    writer: Writer<BufWriter<File>>,
    /// The channels with their numbers of messages, in the order of the topics.
    channels: Vec<(u16, u32)>,
}

impl McapFile {
    /// Creates the file.
    ///
    /// # Errors
    ///
    /// The file exists, or cannot be written.
    pub fn create<'a>(
        path: &Path,
        topics: impl IntoIterator<Item = &'a str>,
    ) -> Result<Self, PeerError> {
        let file = File::create_new(path).map_err(failed())?;
        let options = WriteOptions::new().compression(None);
        let mut writer = options.create(BufWriter::new(file)).map_err(failed())?;
        let mut channels = Vec::new();
        for topic in topics {
            // 0: the channel has no schema.
            let id = writer.add_channel(0, topic, "bytes", &BTreeMap::new());
            channels.push((id.map_err(failed())?, 0));
        }
        Ok(Self { writer, channels })
    }

    /// Writes a message of a topic, by the number of the topic.
    ///
    /// # Errors
    ///
    /// The file cannot be written.
    pub fn write(&mut self, topic: usize, message: &[u8]) -> Result<(), PeerError> {
        let (channel_id, sequence) = &mut self.channels[topic];
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        let now_ns = since.map_or(0, |since| since.as_nanos() as u64);
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: *sequence,
            log_time: now_ns,
            publish_time: now_ns,
        };
        *sequence = sequence.wrapping_add(1);
        let written = self.writer.write_to_known_channel(&header, message);
        written.map_err(failed())
    }

    /// Completes the file, and waits until it is on the disk.
    ///
    /// # Errors
    ///
    /// The file cannot be written.
    pub fn finish(mut self) -> Result<(), PeerError> {
        self.writer.finish().map_err(failed())?;
        let mut file = self.writer.into_inner();
        file.flush().map_err(failed())?;
        file.get_ref().sync_data().map_err(failed())
    }
}

fn failed<E: Display>() -> impl FnOnce(E) -> PeerError {
    PeerError::caused("write the file")
}

#[cfg(test)]
mod tests {
    use super::McapFile;
    use crate::{
        payload::{Header, fill},
        recorded::Content,
    };

    #[test]
    fn what_was_written_is_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file.mcap");
        let mut file = McapFile::create(&path, ["a", "b"]).unwrap();
        for (topic, number) in [(0, 0), (1, 0), (0, 2), (1, 1)] {
            let mut message = vec![0; 100];
            let header = Header {
                number,
                ..Header::default()
            };
            fill(header, &mut message);
            if number == 1 {
                message[99] ^= 1;
            }
            file.write(topic, &message).unwrap();
        }
        assert!(McapFile::create(&path, ["a"]).is_err());
        file.finish().unwrap();
        let content = Content::of(&path).unwrap();
        assert_eq!(content.missing("a", 3), 1);
        assert_eq!(content.missing("b", 1), 0);
        assert_eq!((content.torn, content.bytes), (1, 400));
    }
}
