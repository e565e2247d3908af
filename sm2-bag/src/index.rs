//! The number of messages in a bag by its index, without reading the messages.

use std::collections::BTreeMap;
use std::fs::File;

use mcap::records::{ChunkIndex, Statistics, op};
use mcap::{McapError, McapResult, Summary};

use crate::chunk::{RECORD_HEAD_BYTES, RawRecord, RecordReader};
use crate::report::{Counts, widen};

/// Counts the messages of each channel by the message indexes behind the chunks of a file of `end` bytes. `None` unless
/// the statistics, the entries of the chunks and the message indexes all say the same, so that no message is outside of
/// the chunks, and no time of a chunk hides one. The counts have no lengths.
pub(crate) fn counts(
    file: &File,
    summary: &Summary,
    end: u64,
) -> McapResult<Option<BTreeMap<u16, Counts>>> {
    let Some(stats) = summary.stats.as_ref().filter(|it| is_whole(it, summary)) else {
        return Ok(None);
    };
    let mut counts = BTreeMap::<u16, Counts>::new();
    let mut times = None;
    for chunk in &summary.chunk_indexes {
        match of_chunk(file, chunk, end, &mut counts) {
            Ok(Some(of_chunk)) => times = widened(times, of_chunk),
            // A chunk without messages, or without an index: then the sum is wrong.
            Ok(None) => {}
            Err(McapError::BadIndex | McapError::UnexpectedEof) => return Ok(None),
            Err(error) => return Err(error),
        }
    }
    let said = stats.channel_message_counts.iter();
    let said = said.filter(|(_, messages)| **messages > 0);
    let found = counts.iter().map(|(id, it)| (id, &it.messages));
    let is_same = said.eq(found)
        && stats.message_count == counts.values().map(|it| it.messages).sum::<u64>()
        && times.is_none_or(|it| it == (stats.message_start_time, stats.message_end_time))
        && counts.keys().all(|id| summary.channels.contains_key(id));
    Ok(is_same.then_some(counts))
}

/// Whether the summary has all records that the statistics count.
fn is_whole(stats: &Statistics, summary: &Summary) -> bool {
    let counted = |count: u32, len: usize| usize::try_from(count) == Ok(len);
    counted(stats.channel_count, summary.channels.len())
        && counted(stats.chunk_count, summary.chunk_indexes.len())
        && counted(stats.attachment_count, summary.attachment_indexes.len())
        && counted(stats.metadata_count, summary.metadata_indexes.len())
}

fn widened(mut times: Option<(u64, u64)>, (from, to): (u64, u64)) -> Option<(u64, u64)> {
    widen(&mut times, from);
    widen(&mut times, to);
    times
}

/// Counts the messages of one chunk. Returns the times of the first and of the last one.
fn of_chunk(
    file: &File,
    chunk: &ChunkIndex,
    end: u64,
    counts: &mut BTreeMap<u16, Counts>,
) -> McapResult<Option<(u64, u64)>> {
    let from = chunk.chunk_start_offset.checked_add(chunk.chunk_length);
    let to = from.and_then(|it| it.checked_add(chunk.message_index_length));
    let (Some(from), Some(to)) = (from, to.filter(|it| *it <= end)) else {
        return Err(McapError::BadIndex);
    };
    let mut places = chunk.message_index_offsets.clone();
    let mut times = None;
    let mut reader = RecordReader::new(file, from, to);
    while let Some(record) = reader.next()? {
        let (channel, entries) = entries(&record).ok_or(McapError::BadIndex)?;
        if places.remove(&channel) != Some(record.offset) {
            return Err(McapError::BadIndex);
        }
        for [time, _place] in entries {
            counts.entry(channel).or_default().messages += 1;
            widen(&mut times, u64::from_le_bytes(*time));
        }
    }
    let said = (chunk.message_start_time, chunk.message_end_time);
    match places.is_empty() && times.is_none_or(|it| it == said) {
        true => Ok(times),
        false => Err(McapError::BadIndex),
    }
}

/// The channel of a message index, and its entries: the time and the place of each message.
fn entries(record: &RawRecord) -> Option<(u16, &[[[u8; 8]; 2]])> {
    let body = &record.bytes()[RECORD_HEAD_BYTES..];
    let (channel, rest) = body.split_first_chunk()?;
    let (len, entries) = rest.split_first_chunk()?;
    let is_index = record.opcode == op::MESSAGE_INDEX
        && usize::try_from(u32::from_le_bytes(*len)) == Ok(entries.len());
    let (words, []) = entries.as_chunks() else {
        return None;
    };
    let (pairs, []) = words.as_chunks() else {
        return None;
    };
    is_index.then_some((u16::from_le_bytes(*channel), pairs))
}

#[cfg(test)]
mod tests {
    use std::io::{Cursor, Write};

    use mcap::records::MessageHeader;
    use mcap::{Summary, Writer};

    use super::*;

    /// A bag of two channels and two chunks, and its summary.
    fn bag() -> (File, Summary, u64) {
        let mut writer = Writer::new(Cursor::new(Vec::new())).unwrap();
        let channels = ["a", "b"].map(|it| {
            let metadata = BTreeMap::new();
            writer.add_channel(0, it, "plain", &metadata).unwrap()
        });
        for (at, channel_id) in [0, 1, 0].map(|it| channels[it]).into_iter().enumerate() {
            let header = MessageHeader {
                channel_id,
                sequence: 0,
                log_time: 10 + at as u64,
                publish_time: 0,
            };
            writer.write_to_known_channel(&header, b"x").unwrap();
            writer.flush().unwrap();
        }
        writer.finish().unwrap();
        let bytes = writer.into_inner().into_inner();
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(&bytes).unwrap();
        let summary = Summary::read(&bytes).unwrap().unwrap();
        (file, summary, bytes.len() as u64)
    }

    #[test]
    fn counts_are_those_of_the_messages() {
        let (file, summary, end) = bag();
        assert!(summary.chunk_indexes.len() > 1);
        let counted = counts(&file, &summary, end).unwrap().unwrap();
        let counted = counted
            .iter()
            .map(|(id, it)| (&*summary.channels[id].topic, it.messages));
        let mut counted: Vec<_> = counted.collect();
        counted.sort_unstable();
        assert_eq!(counted, [("a", 2), ("b", 1)]);
    }

    /// One number that differs from the others is enough.
    #[test]
    fn what_does_not_agree_has_no_counts() {
        type Change = fn(&mut Summary);
        let changes: [(&str, Change); 16] = [
            ("no statistics", |it| it.stats = None),
            ("channels", |it| {
                it.stats.as_mut().unwrap().channel_count += 1
            }),
            ("chunks", |it| it.stats.as_mut().unwrap().chunk_count -= 1),
            ("attachments", |it| {
                it.stats.as_mut().unwrap().attachment_count += 1
            }),
            ("metadata", |it| {
                it.stats.as_mut().unwrap().metadata_count += 1
            }),
            ("messages", |it| {
                it.stats.as_mut().unwrap().message_count += 1
            }),
            ("first time", |it| {
                it.stats.as_mut().unwrap().message_start_time -= 1
            }),
            ("last time", |it| {
                it.stats.as_mut().unwrap().message_end_time += 1
            }),
            ("messages of a channel", |it| {
                let stats = it.stats.as_mut().unwrap();
                let mut counts = stats.channel_message_counts.values_mut();
                *counts.next().unwrap() += 1;
            }),
            ("a missing channel", |it| {
                let id = *it.channels.keys().next().unwrap();
                it.channels.remove(&id);
                it.stats.as_mut().unwrap().channel_count -= 1;
            }),
            ("a missing chunk", |it| {
                it.chunk_indexes.pop();
                it.stats.as_mut().unwrap().chunk_count -= 1;
            }),
            ("first time of a chunk", |it| {
                it.chunk_indexes[0].message_start_time -= 1
            }),
            ("last time of a chunk", |it| {
                it.chunk_indexes[0].message_end_time += 1
            }),
            ("an index too few", |it| {
                it.chunk_indexes[0].message_index_offsets.clear()
            }),
            ("an index too many", |it| {
                it.chunk_indexes[0].message_index_offsets.insert(77, 0);
            }),
            ("the length of the indexes", |it| {
                it.chunk_indexes[0].message_index_length = u64::MAX;
            }),
        ];
        let (file, summary, end) = bag();
        for (what, change) in changes {
            let mut changed = summary.clone();
            change(&mut changed);
            assert_eq!(counts(&file, &changed, end).unwrap(), None, "{what}");
        }
        // The file is shorter than its summary says.
        assert_eq!(counts(&file, &summary, 30).unwrap(), None);
    }
}
