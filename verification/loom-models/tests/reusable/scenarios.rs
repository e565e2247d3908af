//! An owner that lends its value, and a thread that reads it.

use loom::cell::UnsafeCell;
use loom::thread;

use super::reusable::Reusable;

/// A number whose accesses loom compares, also that of its drop.
struct Number(UnsafeCell<u64>);

impl Number {
    fn get(&self) -> u64 {
        // SAFETY: loom fails if another thread writes it meanwhile.
        self.0.with(|it| unsafe { *it })
    }

    fn set(&mut self, number: u64) {
        // SAFETY: loom fails if another thread uses it meanwhile.
        self.0.with_mut(|it| unsafe { *it = number });
    }
}

impl Drop for Number {
    fn drop(&mut self) {
        self.set(0);
    }
}

fn number() -> Reusable<Number> {
    Reusable::new(Number(UnsafeCell::new(0)))
}

/// The owner writes the value again once the thread has dropped it. The thread reads what was lent to it.
pub(crate) fn again() {
    let mut owner = number();
    let lent = owner.lend(|it| it.set(1)).expect("it is not lent");
    let reader = thread::spawn(move || assert_eq!(lent.get(), 1));
    if let Some(lent) = owner.lend(|it| it.set(2)) {
        assert_eq!(lent.get(), 2);
    }
    reader.join().unwrap();
    assert!(owner.lend(|it| it.set(3)).is_some());
}

/// The owner and the thread drop their ends at the same time, and one of them drops the value.
pub(crate) fn ends() {
    let mut owner = number();
    let lent = owner.lend(|it| it.set(1)).expect("it is not lent");
    let reader = thread::spawn(move || assert_eq!(lent.get(), 1));
    drop(owner);
    reader.join().unwrap();
}
