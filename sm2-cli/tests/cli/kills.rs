//! Recorders that are killed at any moment leave bags that can be read.

use std::{
    fs,
    path::Path,
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::Duration,
};

use nix::sys::signal::Signal;
use sm2_bag::{Bag, Filter, recover};
use sm2_test_support::seed;

use crate::common::{Domain, until};

const KILLS: usize = if cfg!(feature = "slow") { 200 } else { 10 };
/// Each kill with such a number waits for a long message. The others come at random moments.
const LONG_EVERY: usize = 5;

/// Every tenth message is long, so that it is written from its slot. Each one begins with its number.
fn message(number: u64) -> Vec<u8> {
    let len = if number.is_multiple_of(10) { 70_000 } else { 8 };
    let mut message = vec![number as u8; len];
    message[..8].copy_from_slice(&number.to_le_bytes());
    message
}

/// The numbers of the messages in a bag, which are consecutive and not damaged. A file without its first bytes has
/// none.
fn readable(path: &Path) -> Vec<u64> {
    let mut numbers = Vec::new();
    let Ok(bag) = Bag::open(path) else {
        return numbers;
    };
    for found in bag.messages(&Filter::default()) {
        let data = found.unwrap().data;
        let number = u64::from_le_bytes(data[..8].try_into().unwrap());
        assert!(numbers.last().is_none_or(|it| it + 1 == number));
        assert!(data == message(number), "message {number}");
        numbers.push(number);
    }
    numbers
}

/// When a recorder is killed.
enum Moment {
    /// When the bag has a long message.
    Long,
    /// So long after the file has been made.
    After(Duration),
}

fn long_ones(numbers: &[u64]) -> usize {
    numbers.iter().filter(|it| it.is_multiple_of(10)).count()
}

/// Records, kills the recorder, and returns the numbers of the messages in the bag.
fn kill(domain: &Domain, path: &Path, moment: &Moment) -> Vec<u64> {
    let file = path.to_str().unwrap();
    let arguments = ["record", "numbers", "--reliable", "numbers", "-o", file];
    let recorder = domain.start(&[&arguments[..], &["--sync", "5ms"]].concat());
    until("the file is there", || path.exists());
    match moment {
        Moment::Long => until("a long message is in the bag", || {
            long_ones(&readable(path)) > 0
        }),
        Moment::After(time) => thread::sleep(*time),
    }
    let before = readable(path);
    recorder.signal(Signal::SIGKILL);
    recorder.finish();
    let left = readable(path);
    // The messages that could be read before the kill can still be read.
    assert!(left.starts_with(&before), "{left:?} of {before:?}");
    left
}

/// Ends the publisher, also when the test fails.
struct End<'a>(&'a AtomicBool);

impl Drop for End<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[test]
fn kills_leave_bags_that_can_be_read() {
    let domain = Domain::new();
    let node = domain.node("talker");
    let numbers = node.publisher_builder::<[u8]>("numbers");
    let numbers = numbers.reliable(true).declare().unwrap();
    let is_over = AtomicBool::new(false);
    thread::scope(|scope| {
        let _end = End(&is_over);
        scope.spawn(|| {
            let mut number = 0;
            while !is_over.load(Ordering::Relaxed) {
                if numbers.try_publish(&message(number)).unwrap().is_some() {
                    number += 1;
                }
                thread::sleep(Duration::from_micros(300));
            }
        });
        let (path, whole) = (domain.path("killed.mcap"), domain.path("whole.mcap"));
        let mut long = 0;
        let mut state = seed();
        for kill_number in 0..KILLS {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            // The moments are spread over starting, linking and writing.
            let moment = match kill_number % LONG_EVERY {
                0 => Moment::Long,
                _ => Moment::After(Duration::from_micros((state >> 33) % 60_000)),
            };
            let left = kill(&domain, &path, &moment);
            if !left.is_empty() {
                long += long_ones(&left);
                assert!(recover(&path, &whole).unwrap().complete);
                assert_eq!(readable(&whole), left);
                fs::remove_file(&whole).unwrap();
            }
            fs::remove_file(&path).unwrap();
        }
        assert!(long > KILLS / 10, "{long} long messages");
    });
}
