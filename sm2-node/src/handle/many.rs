//! Many messages at a time: one look, one lock, and one more to give them all back.

use super::Handle;
use super::receive::{Receipt, Received};
use crate::driver::LinkToken;
use crate::driver::{Inner, Taken, Topic, Until};
use crate::{RecvError, Wait};

impl Handle {
    /// Waits until there is a message, and takes all that are there, at most so many. None: the
    /// time is over.
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
        let topic = Topic::Interface(self.id);
        let found = self.shared.wait_as(way, topic, until, |inner| {
            self.look(inner, |inner| self.take_ready(inner, &mut all, most))
        });
        found.map_err(RecvError::Io)?.transpose()?;
        Ok(all)
    }

    /// Whether something was found: messages, or why there are none.
    fn take_ready(
        &self,
        inner: &mut Inner,
        all: &mut Vec<Taken>,
        most: usize,
    ) -> Option<Result<(), RecvError>> {
        let taken = inner.with(self.id, &self.shared.epoll, |interface, tools| {
            interface.take_many(all, most, tools)
        })?;
        match taken {
            _ if !all.is_empty() => Some(Ok(())),
            Err(full) => Some(Err(full.into())),
            Ok(()) => None,
        }
    }

    /// Makes messages readable that were taken: each is given back by itself.
    pub(crate) fn open_many(
        &self,
        taken: Vec<Taken>,
    ) -> impl Iterator<Item = Result<Received, RecvError>> {
        taken.into_iter().map(|it| self.open_for(it))
    }

    /// Shows each of these messages to `each`, and then gives all of them back.
    pub(crate) fn lend(
        &self,
        taken: Vec<Taken>,
        mut each: impl FnMut(Result<Received, RecvError>),
    ) {
        let places = |it: &Taken| (it.token, it.delivery.sequence);
        let _lent = Lent {
            handle: self,
            places: taken.iter().map(places).collect(),
        };
        for taken in taken {
            let opened = self.open_with(taken, Receipt::none());
            each(opened.map_err(RecvError::from));
        }
    }
}

/// Messages to be given back together, also if whoever looks at them panics.
struct Lent<'a> {
    handle: &'a Handle,
    /// Of each the token of its link and its number there.
    places: Vec<(LinkToken, u64)>,
}

impl Drop for Lent<'_> {
    //= SM2-MSG-005
    fn drop(&mut self) {
        self.handle.with_idle(|interface, tools| {
            for &(token, sequence) in &self.places {
                interface.give_back(token, sequence, tools);
            }
        });
    }
}
