//! Receiving the messages of a topic.

use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use sm2_proto::{Contract, Demand, Kind, TypeId};

use crate::driver::{Interface, Shared, Until};
use crate::handle::Handle;
use crate::handle::declaration::{Declaration, schema_of, sealed_setter, wait_setter};
use crate::handle::methods::interface_methods;
use crate::{DeclareError, Message, RecvError, Sample, Wait};

/// Receives messages of type `T` from all publishers of a topic, from each in turn.
///
/// What the program has not taken waits: up to `depth` messages of each publisher, of which the
/// oldest gives way to a new one (SM2-QOS-001), or as many as there are if the subscriber
/// is reliable. What it has taken is lent to it until it drops the [`Sample`]; one
/// that holds `max_borrowed` of them gets no further ones (SM2-MSG-005), and harms nobody else.
///
/// Its [descriptor](std::os::fd::AsFd) is readable when [`try_recv`](Self::try_recv) may have a message: take
/// until there is none, then poll again.
#[derive(Debug)]
pub struct Subscriber<T: Message + ?Sized> {
    handle: Handle,
    receives: PhantomData<fn(&T)>,
}

interface_methods! {
    Subscriber<T>,
    topic: "The name of its topic.",
    "publishers": wait_for_publishers, wait_for_publishers_timeout,
}

impl<T: Message + ?Sized> Subscriber<T> {
    const fn handle(&self) -> &Handle {
        &self.handle
    }

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
        let received = self.handle.receive(until, Interface::take)?;
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
        let taken = self.handle.take_many(self.handle.wait, until, most)?;
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
}

/// A subscriber's quality of service.
#[derive(Debug)]
#[must_use = "a builder does nothing until declare is called"]
pub struct SubscriberBuilder<T: Message + ?Sized> {
    declaration: Declaration,
    /// None takes every type.
    data: Option<TypeId>,
    demand: Demand,
    receives: PhantomData<fn(&T)>,
}

impl<T: Message + ?Sized> SubscriberBuilder<T> {
    pub(crate) fn new(shared: &Arc<Shared>, topic: &str) -> Self {
        Self {
            declaration: Declaration::new(shared, topic),
            data: Some(T::type_id()),
            demand: Demand {
                depth: 8,
                reliable: false,
                max_borrowed: 4,
                sealed: false,
            },
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

    wait_setter!("a message");
    sealed_setter!(
        demand,
        "Accepts sealed messages only: their publisher cannot change them after they are sent."
    );

    /// Declares it, and waits for the Manager's word.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    pub fn declare(self) -> Result<Subscriber<T>, DeclareError> {
        let contract = Contract::Subscriber {
            topic: self.declaration.checked_name(Kind::Subscriber)?,
            data: self.data,
            demand: self.demand,
        };
        Ok(Subscriber {
            handle: self.declaration.declare(contract, 0, [schema_of::<T>()])?,
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
