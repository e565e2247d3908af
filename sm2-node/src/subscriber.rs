//! Receiving the messages of a topic.

use std::marker::PhantomData;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::time::Duration;

use sm2_proto::{Contract, Demand, Kind, TypeId};

use crate::driver::LinkStatus;
use crate::driver::{Interface, Shared, Until};
use crate::error::QueryError;
use crate::handle::Handle;
use crate::publisher::{checked_name, schema_of};
use crate::{DeclareError, Message, RecvError, Sample, Wait, WaitError};
use sm2_proto::domain::Near;

/// Receives messages of type `T` from all publishers of a topic, from each in turn.
///
/// What the program has not taken waits: up to `depth` messages of each publisher, of which the
/// oldest gives way to a new one (SM2-QOS-001), or as many as there are if the subscriber
/// is reliable. What it has taken is lent to it until it drops the [`Sample`]; one
/// that holds `max_borrowed` of them gets no further ones (SM2-MSG-005), and harms nobody else.
///
/// Its [descriptor](AsFd) is readable when [`try_recv`](Self::try_recv) may have a message: take
/// until there is none, then poll again.
#[derive(Debug)]
pub struct Subscriber<T: Message + ?Sized> {
    handle: Handle,
    wait: Wait,
    receives: PhantomData<fn(&T)>,
}

impl<T: Message + ?Sized> Subscriber<T> {
    /// The next message; waits for it, as long as it takes: also for a publisher, and while the
    /// Manager is gone for another one.
    ///
    /// # Errors
    ///
    /// See [`RecvError`].
    pub fn recv(&self) -> Result<Sample<T>, RecvError> {
        loop {
            if let Some(sample) = self.take(Until::Forever)? {
                return Ok(sample);
            }
        }
    }

    /// The next message, if one is there.
    ///
    /// # Errors
    ///
    /// See [`RecvError`].
    pub fn try_recv(&self) -> Result<Option<Sample<T>>, RecvError> {
        self.take(Until::NOW)
    }

    /// The next message; waits for it at most this long.
    ///
    /// # Errors
    ///
    /// See [`RecvError`].
    pub fn recv_timeout(&self, timeout: Duration) -> Result<Option<Sample<T>>, RecvError> {
        self.take(Until::In(timeout))
    }

    fn take(&self, until: Until) -> Result<Option<Sample<T>>, RecvError> {
        let received = self.handle.receive(self.wait, until, Interface::take)?;
        received.map(Sample::new).transpose()
    }

    /// Takes as many messages as there are, at most `most` and as many as it may hold, and puts them
    /// behind those in `samples`; how many they are. Quicker than to take them one by one.
    ///
    /// # Errors
    ///
    /// See [`RecvError`]. Of several messages that cannot be read, the last is reported; all others are in
    /// `samples`.
    pub fn try_recv_many(
        &self,
        samples: &mut Vec<Sample<T>>,
        most: usize,
    ) -> Result<usize, RecvError> {
        let before = samples.len();
        let taken = self.handle.take_many(Wait::Park, Until::NOW, most)?;
        let mut failed = None;
        for received in self.handle.open_many(taken) {
            match received.and_then(Sample::new) {
                Ok(sample) => samples.push(sample),
                Err(error) => failed = Some(error),
            }
        }
        failed.map_or(Ok(samples.len() - before), Err)
    }

    /// Calls `each` with every message that has arrived: at most `most`, and at most as many as the
    /// program may [hold](SubscriberBuilder::max_borrowed). Then gives all of them back together,
    /// and returns their number. Waits for the first message, without a time limit.
    ///
    /// This is the quickest way to receive many short messages. `each` runs in this thread and may
    /// call the node; while it runs, no message of this batch is given back. For a message that
    /// cannot be read, `each` gets the error.
    ///
    /// # Errors
    ///
    /// See [`RecvError`]: no message was taken.
    pub fn recv_each(
        &self,
        most: usize,
        each: impl FnMut(Result<&Sample<T>, RecvError>),
    ) -> Result<usize, RecvError> {
        self.take_each(most, Until::Forever, each)
    }

    /// As [`recv_each`](Self::recv_each), but waits for at most `timeout`; then 0.
    ///
    /// # Errors
    ///
    /// As [`recv_each`](Self::recv_each).
    pub fn recv_each_timeout(
        &self,
        most: usize,
        timeout: Duration,
        each: impl FnMut(Result<&Sample<T>, RecvError>),
    ) -> Result<usize, RecvError> {
        self.take_each(most, Until::In(timeout), each)
    }

    /// As [`recv_each`](Self::recv_each), but never waits.
    ///
    /// # Errors
    ///
    /// As [`recv_each`](Self::recv_each).
    pub fn try_recv_each(
        &self,
        most: usize,
        each: impl FnMut(Result<&Sample<T>, RecvError>),
    ) -> Result<usize, RecvError> {
        self.take_each(most, Until::NOW, each)
    }

    fn take_each(
        &self,
        most: usize,
        until: Until,
        mut each: impl FnMut(Result<&Sample<T>, RecvError>),
    ) -> Result<usize, RecvError> {
        let taken = self.handle.take_many(self.wait, until, most)?;
        let count = taken.len();
        self.handle
            .lend(taken, |received| match received.and_then(Sample::new) {
                Ok(sample) => each(Ok(&sample)),
                Err(error) => each(Err(error)),
            });
        Ok(count)
    }

    /// How many messages were lost before those that were taken, of all publishers together.
    pub fn lost(&self) -> u64 {
        self.handle.with(|interface, _| interface.lost)
    }

    /// How many publishers matched when it was declared (SM2-IFC-002).
    #[must_use]
    pub const fn matched(&self) -> usize {
        self.handle.matched()
    }

    /// Waits until at least `count` publishers are linked, without a time limit.
    ///
    /// # Errors
    ///
    /// [`WaitError::Io`].
    pub fn wait_for_publishers(&self, count: usize) -> Result<(), WaitError> {
        self.handle.wait_open(count, None)
    }

    /// Waits until at least `count` publishers are linked, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// See [`WaitError`].
    pub fn wait_for_publishers_timeout(
        &self,
        count: usize,
        timeout: Duration,
    ) -> Result<(), WaitError> {
        self.handle.wait_open(count, Some(timeout))
    }

    /// Whether the Manager has it: not while there is none, and not if another one took over
    /// that refused it, which is logged with the reason (SM2-RES-009). Links that are open go on.
    #[must_use]
    pub fn is_registered(&self) -> bool {
        self.handle.is_registered()
    }

    /// Of the interfaces that are there, those that come closest to a publisher for this subscriber, and why
    /// each of them does not match: for one that stays without links.
    ///
    /// # Errors
    ///
    /// See [`QueryError`].
    pub fn why(&self) -> Result<Vec<Near>, QueryError> {
        self.handle.why()
    }

    /// Its links: those that ended (the last 64 of them), then those that are there. What
    /// came is in [`LinkStatus::received`]; the counters are the publishers' and all zero here.
    pub fn links(&self) -> Vec<LinkStatus> {
        self.handle.links()
    }
}

impl<T: Message + ?Sized> AsFd for Subscriber<T> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.handle.descriptor()
    }
}

/// A subscriber's quality of service.
#[derive(Debug)]
#[must_use = "a builder does nothing until declare is called"]
pub struct SubscriberBuilder<T: Message + ?Sized> {
    shared: Arc<Shared>,
    topic: String,
    /// None takes every type.
    data: Option<TypeId>,
    demand: Demand,
    wait: Wait,
    receives: PhantomData<fn(&T)>,
}

impl<T: Message + ?Sized> SubscriberBuilder<T> {
    pub(crate) fn new(shared: &Arc<Shared>, topic: &str) -> Self {
        Self {
            shared: Arc::clone(shared),
            topic: topic.to_owned(),
            data: Some(T::type_id()),
            demand: Demand {
                depth: 8,
                reliable: false,
                max_borrowed: 4,
                sealed: false,
            },
            wait: Wait::Park,
            receives: PhantomData,
        }
    }

    /// How many messages of each publisher wait to be taken: 1 to 1,024; 8 by default.
    pub const fn depth(mut self, messages: u16) -> Self {
        self.demand.depth = messages;
        self
    }

    /// Asks for reliable delivery; `false` by default. No message displaces another one: the
    /// publisher waits until this subscriber has room, for at most its
    /// [`publish_timeout`](crate::PublisherBuilder::publish_timeout) (SM2-QOS-002). A reliable
    /// subscriber matches reliable publishers only.
    pub const fn reliable(mut self, reliable: bool) -> Self {
        self.demand.reliable = reliable;
        self
    }

    /// How many samples of each publisher the program may hold: 1 to 1,024; 4 by default.
    ///
    /// Who only wants the latest message takes `depth(1).max_borrowed(1)`: a publisher then needs
    /// the fewest slots for it. Drop the sample before the next is taken.
    pub const fn max_borrowed(mut self, messages: u16) -> Self {
        self.demand.max_borrowed = messages;
        self
    }

    /// What [`recv`](Subscriber::recv) and [`recv_timeout`](Subscriber::recv_timeout) do while
    /// nothing is there; [`Wait::Park`] by default.
    pub const fn wait(mut self, way: Wait) -> Self {
        self.wait = way;
        self
    }

    /// Every message has to be sealed: its publisher cannot change it any more.
    pub const fn sealed(mut self, sealed: bool) -> Self {
        self.demand.sealed = sealed;
        self
    }

    /// Declares it, and waits for the Manager's word.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    pub fn declare(self) -> Result<Subscriber<T>, DeclareError> {
        let contract = Contract::Subscriber {
            topic: checked_name(Kind::Subscriber, self.topic)?,
            data: self.data,
            demand: self.demand,
        };
        Ok(Subscriber {
            handle: Handle::declare(&self.shared, contract, 0, [schema_of::<T>()])?,
            wait: self.wait,
            receives: PhantomData,
        })
    }
}

impl SubscriberBuilder<[u8]> {
    /// Takes messages of every type, as bytes; [`Sample::type_id`] says which it is.
    pub fn any_type(mut self) -> Self {
        self.data = None;
        self
    }

    /// Takes messages of this type, as bytes.
    pub fn type_id(mut self, data: TypeId) -> Self {
        self.data = Some(data);
        self
    }
}
