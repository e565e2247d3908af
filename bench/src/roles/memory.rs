//! Writes and reads messages within one process, to measure the memory alone.

use std::{
    hint::black_box,
    sync::{Barrier, PoisonError},
    thread,
};

use crate::{
    clock::now_ns,
    job::{MemoryWork, Outcome, Read},
    payload::{Header, check, fill, peek},
    stats::{Durations, Spread},
};

/// Each thread repeatedly writes a message into memory of its own and reads it `readers` times. The
/// result adds up the rates of all threads: the rate of a publisher and its subscribers on as many
/// cores if communication cost nothing.
pub(super) fn work(work: &MemoryWork) -> Outcome {
    let start = Barrier::new(work.threads);
    let one_way = std::sync::Mutex::new(None);
    let hz = thread::scope(|scope| {
        let threads: Vec<_> = (0..work.threads)
            .map(|_| {
                scope.spawn(|| {
                    let (hz, spread) = run_thread(work, &start);
                    *one_way.lock().unwrap_or_else(PoisonError::into_inner) = Some(spread);
                    hz
                })
            })
            .collect();
        let rates = threads.into_iter().map(|thread| thread.join());
        rates.map(|rate| rate.unwrap_or(0.0)).sum()
    });
    let one_way = one_way.into_inner().unwrap_or_else(PoisonError::into_inner);
    Outcome::Memory {
        hz,
        one_way_ns: one_way.unwrap_or_default(),
    }
}

fn run_thread(work: &MemoryWork, start: &Barrier) -> (f64, Spread) {
    let mut message = vec![0; work.len];
    let mut one_way = Durations::with_capacity(1 << 16);
    // Reading the clock takes about as long as a short message: read it once per batch.
    let batch = (65_536 / work.len).max(1) as u64;
    start.wait();
    let start_ns = now_ns();
    let (mut number, mut before_ns) = (0, start_ns);
    loop {
        for _ in 0..batch {
            number += 1;
            let header = Header {
                number,
                ..Header::default()
            };
            fill(header, black_box(&mut message));
            for _ in 0..work.readers {
                let message = black_box(&message[..]);
                let read = match work.read {
                    Read::Full => check(message),
                    Read::Header => peek(message),
                };
                debug_assert!(read.is_ok());
                let _ = black_box(read);
            }
        }
        let now = now_ns();
        one_way.record((now - before_ns) / batch);
        before_ns = now;
        if (now - start_ns) as f64 / 1e9 >= work.seconds {
            let hz = number as f64 * 1e9 / (now - start_ns) as f64;
            return (hz, one_way.spread());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::work;
    use crate::job::{MemoryWork, Outcome, Read};

    #[test]
    fn every_thread_adds_to_the_rate() {
        let outcome = work(&MemoryWork {
            len: 4_096,
            readers: 2,
            read: Read::Full,
            threads: 2,
            seconds: 0.01,
        });
        let Outcome::Memory { hz, one_way_ns } = outcome else {
            panic!("{outcome:?}");
        };
        assert!(hz > 0.0 && one_way_ns.count > 0);
    }
}
