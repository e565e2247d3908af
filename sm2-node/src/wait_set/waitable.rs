//! The sources of a wait set that belong to a node.

use std::sync::Arc;

use sm2_proto::Instant;

use crate::driver::{Condition, SharedInterface};
use crate::{Call, Events, Message, Publisher, Server, Subscriber};

/// A source of a [`WaitSet`](crate::WaitSet) that belongs to a node. Only types of this crate implement it.
///
/// | source | ready when | then call |
/// | --- | --- | --- |
/// | [`Subscriber`] | a message may be there | [`try_recv`](Subscriber::try_recv) |
/// | [`Server`] | a request may be there | [`try_recv`](Server::try_recv) |
/// | [`Call`] | its reply or its failure is there, or its deadline has passed | [`try_wait`](Call::try_wait) |
/// | [`Events`] | an event is there | [`try_next`](Events::try_next) |
/// | [`Changes`] of parameters | a request may be there | [`Changes::try_next`] |
/// | [`Publisher`] | every reliable subscriber has room | [`try_publish`](Publisher::try_publish) |
///
/// [`Changes`]: crate::params::Changes
/// [`Changes::try_next`]: crate::params::Changes::try_next
///
/// A publisher is ready most of the time. So a program adds it while it has a message that found no room, and then
/// removes it, as it would wait for a writable socket.
#[allow(private_bounds, reason = "only types of this crate implement it")]
pub trait Waitable: Source {}

impl<S: Source> Waitable for S {}

/// A part of a node that a wait set waits for.
pub(crate) trait Source {
    fn interface(&self) -> &Arc<SharedInterface>;

    fn condition(&self) -> Condition;

    /// The time when the source is ready in any case.
    fn deadline(&self) -> Option<Instant> {
        None
    }
}

impl<T: Message + ?Sized> Source for Subscriber<T> {
    fn interface(&self) -> &Arc<SharedInterface> {
        &self.handle().interface
    }

    fn condition(&self) -> Condition {
        Condition::Message
    }
}

impl<Q: Message + ?Sized, R: Message + ?Sized> Source for Server<Q, R> {
    fn interface(&self) -> &Arc<SharedInterface> {
        &self.handle().interface
    }

    fn condition(&self) -> Condition {
        Condition::Message
    }
}

impl<R: Message + ?Sized> Source for Call<R> {
    fn interface(&self) -> &Arc<SharedInterface> {
        self.interface()
    }

    fn condition(&self) -> Condition {
        Condition::Call(self.id())
    }

    fn deadline(&self) -> Option<Instant> {
        self.deadline()
    }
}

impl<T: Message + ?Sized> Source for Publisher<T> {
    fn interface(&self) -> &Arc<SharedInterface> {
        &self.handle().interface
    }

    fn condition(&self) -> Condition {
        Condition::Room
    }
}

impl Source for Events {
    fn interface(&self) -> &Arc<SharedInterface> {
        &self.interface
    }

    fn condition(&self) -> Condition {
        Condition::Event
    }
}
