//! A writer and readers of three words: the turn, and two words that change together.

use std::mem;

use loom::sync::Arc;
use loom::thread;

use crate::sync::AtomicU64;

use super::seqlock::{Change, copy, free};

type Words = [AtomicU64; 3];

fn words() -> Arc<Words> {
    Arc::new(std::array::from_fn(|_| AtomicU64::new(0)))
}

/// Makes a change that ends with turn `2 n` and writes `n` into both words.
fn change(words: &Words, turn: &mut u64) {
    let value = turn.div_ceil(2) + 1;
    write(words, turn, value);
}

fn write(words: &Words, turn: &mut u64, value: u64) {
    let mut change = Change::begin(words, turn);
    change.set(1, value);
    change.set(2, value);
}

/// Makes one attempt to read. Returns the turn if the attempt succeeds.
fn look(words: &Words) -> Option<u64> {
    let [turn, one, other] = copy(words)?;
    if turn > 0 {
        let all = [turn / 2; 2];
        assert_eq!([one, other], all, "a mix of two writings, turn {turn}");
    }
    Some(turn)
}

/// Two changes while a reader reads twice. The reader never sees an older state after a newer one.
pub(crate) fn changes() {
    let words = words();
    let writer = {
        let words = Arc::clone(&words);
        thread::spawn(move || {
            let mut turn = 0;
            for _ in 0..2 {
                change(&words, &mut turn);
            }
        })
    };
    let (first, second) = (look(&words), look(&words));
    if let (Some(first), Some(second)) = (first, second) {
        assert!(first <= second, "an older writing after a newer one");
    }
    writer.join().unwrap();
    assert_eq!(look(&words), Some(4));
}

/// One change and two readers.
pub(crate) fn readers() {
    let words = words();
    let reader = {
        let words = Arc::clone(&words);
        thread::spawn(move || look(&words))
    };
    let writer = {
        let words = Arc::clone(&words);
        thread::spawn(move || {
            change(&words, &mut 0);
        })
    };
    look(&words);
    reader.join().unwrap();
    writer.join().unwrap();
}

/// Words in use are freed and reused while a reader reads twice.
pub(crate) fn reuse() {
    let words = words();
    let mut turn = 0;
    change(&words, &mut turn);
    let writer = {
        let words = Arc::clone(&words);
        thread::spawn(move || {
            free(&words);
            change(&words, &mut turn);
        })
    };
    look(&words);
    look(&words);
    writer.join().unwrap();
    assert_eq!(look(&words), Some(4));
}

/// A change that never ends, and then a change that ends.
pub(crate) fn stopped() {
    let words = words();
    let writer = {
        let words = Arc::clone(&words);
        thread::spawn(move || {
            let mut turn = 0;
            let mut stopped = Change::begin(&words, &mut turn);
            stopped.set(1, 7);
            mem::forget(stopped);
            change(&words, &mut turn);
        })
    };
    look(&words);
    look(&words);
    writer.join().unwrap();
    assert_eq!(look(&words), Some(4));
}

/// A forbidden case: words are reused with turns that they had before.
pub(crate) fn turns_begin_anew() {
    let words = words();
    write(&words, &mut 0, 1);
    let writer = {
        let words = Arc::clone(&words);
        thread::spawn(move || {
            free(&words);
            write(&words, &mut 0, 5);
        })
    };
    if let Some([2, one, other]) = copy(&words) {
        assert_eq!(one, other, "a mix of two writings");
    }
    writer.join().unwrap();
}
