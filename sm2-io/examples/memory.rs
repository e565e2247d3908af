//! Measures how long messages take in shared memory, for each way of allocating the memory: `cargo run
//! --release -p sm2-io --example memory`.
//!
//! The output has medians in microseconds:
//!
//! - `before`: the time to preallocate memory, before the bytes are known.
//! - `ready`: from known bytes to the sealed descriptor.
//! - `read`: to map the message, read every word, and unmap it.
//! - `free`: to close the last descriptor.
//! - `first` and `again`: the first and the second write to a pooled slot.

use std::hint::black_box;
use std::io::{self, IoSlice};
use std::os::fd::OwnedFd;
use std::time::Instant;

use sm2_io::memfd::{sealed_from_bytes, sealed_from_parts};
use sm2_io::{InspectedFd, Preallocated, SealedLoan, SealedMapping, Segment};

const LENGTHS: [usize; 6] = [4_096, 65_536, 262_144, 1_000_000, 10_000_000, 10_485_760];
const TIMES: usize = 101;

/// Makes one message. Returns how long the part before the bytes were known took.
type Way = fn(&[u8]) -> io::Result<(f64, OwnedFd)>;

const WAYS: [(&str, Way); 5] = [
    ("pwrite into new pages", |bytes| {
        sealed_from_parts(&[IoSlice::new(bytes)]).map(|fd| (0.0, fd))
    }),
    ("copy, as the library does", |bytes| {
        sealed_from_bytes(bytes).map(|fd| (0.0, fd))
    }),
    ("copy into a preallocated", |bytes| {
        let (before, preallocated) = timed(|| Preallocated::for_copies(bytes.len()))?;
        Ok((before, preallocated.fill(bytes)?))
    }),
    ("loan", |bytes| {
        let mut loan = SealedLoan::new(bytes.len() as u64)?;
        loan.as_mut_slice().copy_from_slice(bytes);
        Ok((0.0, loan.seal()?))
    }),
    ("loan of a preallocated", |bytes| {
        let (before, preallocated) = timed(|| Preallocated::for_loans(bytes.len()))?;
        let mut loan = preallocated.lend(bytes.len())?;
        loan.as_mut_slice().copy_from_slice(bytes);
        Ok((before, loan.seal()?))
    }),
];

fn timed<T>(work: impl FnOnce() -> io::Result<T>) -> io::Result<(f64, T)> {
    let start = Instant::now();
    let result = work()?;
    Ok((start.elapsed().as_secs_f64() * 1e6, result))
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn main() -> io::Result<()> {
    for len in LENGTHS {
        let bytes = vec![7_u8; len];
        println!("{len} bytes");
        slots(&bytes)?;
        for (name, way) in WAYS {
            let [mut before, mut ready, mut read, mut free] = [(); 4].map(|()| Vec::new());
            for _ in 0..TIMES {
                let (all, (ahead, fd)) = timed(|| way(&bytes))?;
                before.push(ahead);
                ready.push(all - ahead);
                read.push(timed(|| read_all(&fd, len))?.0);
                let start = Instant::now();
                drop(fd);
                free.push(start.elapsed().as_secs_f64() * 1e6);
            }
            let [before, ready, read, free] = [before, ready, read, free].map(median);
            println!(
                "  {name:26} before {before:8.1}  ready {ready:8.1}  read {read:8.1}  free {free:8.1}"
            );
        }
    }
    Ok(())
}

fn slots(bytes: &[u8]) -> io::Result<()> {
    let len = bytes.len();
    for (name, warm) in [
        ("slot, page by page", 0),
        ("slot, as the library does", len),
    ] {
        let [mut first, mut again] = [(); 2].map(|()| Vec::new());
        for _ in 0..TIMES {
            let stride = (len + 64).next_multiple_of(2 << 20);
            let (_fd, mut slots) = Segment::create(stride as u64, 1)?.split();
            for times in [&mut first, &mut again] {
                let start = Instant::now();
                slots[0].warm(warm);
                slots[0].bytes_mut(len).copy_from_slice(bytes);
                times.push(start.elapsed().as_secs_f64() * 1e6);
            }
        }
        let [first, again] = [first, again].map(median);
        println!("  {name:26} first  {first:8.1}  again {again:8.1}");
    }
    Ok(())
}

fn read_all(fd: &OwnedFd, len: usize) -> io::Result<()> {
    let file = InspectedFd::new(fd.try_clone()?)?.into_sealed();
    let mapping = SealedMapping::new(&file.map_err(io::Error::other)?, len as u64, true)?;
    let (words, _) = mapping.as_chunks::<8>();
    let sum = (words.iter()).fold(0_u64, |sum, word| {
        sum.wrapping_add(u64::from_ne_bytes(*word))
    });
    black_box(sum);
    Ok(())
}
