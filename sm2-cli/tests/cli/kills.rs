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

use crate::common::{Domain, until};

const KILLS: usize = 200;

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
    for found in bag.messages(&Filter::default()).unwrap() {
        let data = found.unwrap().data;
        let number = u64::from_le_bytes(data[..8].try_into().unwrap());
        assert!(numbers.last().is_none_or(|it| it + 1 == number));
        assert!(data == message(number), "message {number}");
        numbers.push(number);
    }
    numbers
}

/// Records until the bag has some messages, kills the recorder, and returns the numbers of the messages in the bag.
fn kill(domain: &Domain, path: &Path, after: Duration) -> Vec<u64> {
    let file = path.to_str().unwrap();
    let arguments = ["record", "numbers", "--reliable", "numbers", "-o", file];
    let recorder = domain.start(&[&arguments[..], &["--sync", "5ms"]].concat());
    until("the file is there", || path.exists());
    thread::sleep(after);
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
fn two_hundred_kills_leave_bags_that_can_be_read() {
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
        for kill_number in 0..KILLS {
            // The moments are spread over starting, linking and writing.
            let after = Duration::from_micros(kill_number as u64 * 7_919 % 60_000);
            let left = kill(&domain, &path, after);
            if !left.is_empty() {
                long += left.iter().filter(|it| it.is_multiple_of(10)).count();
                assert!(recover(&path, &whole).unwrap().complete);
                assert_eq!(readable(&whole), left);
                fs::remove_file(&whole).unwrap();
            }
            fs::remove_file(&path).unwrap();
        }
        assert!(long > KILLS / 10, "{long} long messages");
    });
}
