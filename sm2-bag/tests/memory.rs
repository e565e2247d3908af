//! Reading takes a bounded amount of memory, whatever a bag's compressed chunks stand for.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;

use mcap::records::MessageHeader;
use nix::sys::resource::{Resource, getrlimit, setrlimit};
use sm2_bag::{Bag, Compression, Filter, check, copy};
use sm2_test_support::ran_alone;

use crate::common::memory_folder;

const MIB: u64 = 1 << 20;
/// The memory that reading may take, in bytes: that of the messages which wait, and room for the decompressor
/// and the allocator.
const MOST_BYTES: u64 = 100 * MIB;

/// Writes chunks of so many bytes, each with the times from 0 on.
fn write(path: &Path, compression: mcap::Compression, chunks: u64, chunk_bytes: u64) {
    let options = mcap::WriteOptions::new()
        .compression(Some(compression))
        .chunk_size(None);
    let file = BufWriter::new(File::create(path).unwrap());
    let mut writer = options.create(file).unwrap();
    let channel_id = writer.add_channel(0, "zero", "", &BTreeMap::new());
    let channel_id = channel_id.unwrap();
    let data = vec![0; MIB as usize];
    for _ in 0..chunks {
        for log_time in 0..chunk_bytes / MIB {
            let header = MessageHeader {
                channel_id,
                sequence: 0,
                log_time,
                publish_time: 0,
            };
            writer.write_to_known_channel(&header, &data).unwrap();
        }
        writer.flush().unwrap();
    }
    writer.finish().unwrap();
}

/// Limits the memory of this process to what it has, and more.
fn limit(more_bytes: u64) {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let size = status.lines().find_map(|it| it.strip_prefix("VmData:"));
    let size = size.unwrap().trim().strip_suffix(" kB").unwrap();
    let size = size.parse::<u64>().unwrap() * 1_024;
    let (_, hard) = getrlimit(Resource::RLIMIT_DATA).unwrap();
    setrlimit(Resource::RLIMIT_DATA, size + more_bytes, hard).unwrap();
}

/// A chunk of a few bytes that stands for many MiB, and chunks that overlap.
#[test]
fn compressed_chunks_take_a_limited_amount_of_memory() {
    if ran_alone(concat!(
        module_path!(),
        "::compressed_chunks_take_a_limited_amount_of_memory"
    )) {
        return;
    }
    let folder = memory_folder();
    let path = |name: &str| folder.path().join(name);
    let kinds = [
        ("long", mcap::Compression::Zstd, 1, 160),
        ("overlapping", mcap::Compression::Zstd, 8, 20),
        ("lz4", mcap::Compression::Lz4, 1, 400),
        ("more", mcap::Compression::Zstd, 4, 200),
    ];
    let kinds = &kinds[..if cfg!(feature = "slow") { 4 } else { 2 }];
    for &(name, compression, chunks, mib) in kinds {
        write(&path(name), compression, chunks, mib * MIB);
    }
    limit(MOST_BYTES);
    for &(name, _, chunks, mib) in kinds {
        let bag = Bag::open(&path(name)).unwrap();
        let (mut messages, mut last) = (0, 0);
        for message in bag.messages(&Filter::default()) {
            let message = message.unwrap();
            assert_eq!(message.data.len() as u64, MIB);
            assert!(message.log_time >= last);
            last = message.log_time;
            messages += 1;
        }
        assert_eq!(messages, chunks * mib, "{name}");
        assert_eq!(check(&path(name)).unwrap().damages, [], "{name}");
    }
    let bag = Bag::open(&path("long")).unwrap();
    let copied = path("copied");
    copy(&[bag], &copied, &Filter::default(), Compression::Lz4).unwrap();
}
