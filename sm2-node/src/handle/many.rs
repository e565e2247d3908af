//! Taking many messages under one lock, and releasing them under another one.

use super::Handle;
use super::receive::{Received, Unreadable};
use crate::driver::LinkToken;
use crate::driver::{LockedInterface, Taken, Until};
use crate::{RecvError, Wait};

impl Handle {
    /// Waits until there is a message, and takes all available messages, at most `most`. The result is empty
    /// after the timeout.
    pub(crate) fn take_many(
        &self,
        way: Wait,
        until: Until,
        most: usize,
    ) -> Result<Vec<Taken>, RecvError> {
        let mut all = Vec::new();
        if most == 0 {
            return Ok(all);
        }
        self.check_shutdown(until)?;
        let found = self.interface.wait_as(way, until, |locked| {
            self.find_or_clear(locked, |locked| take_ready(locked, &mut all, most))
        });
        found?.transpose()?;
        Ok(all)
    }

    /// Makes taken messages readable, and leaves out those that their senders made unreadable. Each is released
    /// separately.
    pub(crate) fn open_many(
        &self,
        taken: Vec<Taken>,
    ) -> impl Iterator<Item = Result<Received, RecvError>> {
        taken
            .into_iter()
            .filter_map(|it| or_error(self.open_for(it)))
    }

    /// Passes each of these messages to `each`, as [`open_many`](Self::open_many), and then releases all of them.
    pub(crate) fn lend(
        &self,
        taken: Vec<Taken>,
        mut each: impl FnMut(Result<Received, RecvError>),
    ) {
        let mut places: Vec<_> = taken.iter().filter_map(Taken::place).collect();
        // The messages of one link are one batch. The sort keeps their order.
        places.sort_by_key(|it| it.0);
        let _lent = Lent {
            handle: self,
            places,
        };
        for taken in taken {
            if let Some(opened) = or_error(self.open_lent(taken)) {
                each(opened);
            }
        }
    }
}

/// `None` for a message that its sender made unreadable.
fn or_error(opened: Result<Received, Unreadable>) -> Option<Result<Received, RecvError>> {
    match opened {
        Ok(received) => Some(Ok(received)),
        Err(unreadable) => unreadable.check().err().map(Err),
    }
}

/// Returns `Some` if there are messages, or a reason why none can be taken.
fn take_ready(
    locked: &mut LockedInterface<'_>,
    all: &mut Vec<Taken>,
    most: usize,
) -> Option<Result<(), RecvError>> {
    let taken = locked.change(|interface, context| interface.take_many(all, most, context));
    match taken {
        _ if !all.is_empty() => Some(Ok(())),
        Err(full) => Some(Err(full.into())),
        Ok(()) => None,
    }
}

/// Messages that are released together, also if `each` panics.
struct Lent<'a> {
    handle: &'a Handle,
    /// The token of the link and the sequence number of each message, sorted by token.
    places: Vec<(LinkToken, u64)>,
}

impl Drop for Lent<'_> {
    //= SM2-MSG-005
    fn drop(&mut self) {
        if self.places.is_empty() {
            return;
        }
        self.handle.with_undriven(|interface, context| {
            interface.give_back_all(&self.places, context);
        });
    }
}
