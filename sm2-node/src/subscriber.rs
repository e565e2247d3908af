//! Receiving the messages of a topic.

use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use sm2_proto::{Contract, DemandedQos, Kind, Period, TypeId};

use crate::driver::{PoolLimit, SharedNode, Until};
use crate::handle::Handle;
use crate::handle::declaration::{
    Declaration, max_len_setter, schema_of, sealed_setter, wait_setter,
};
use crate::handle::methods::interface_methods;
use crate::{DeclareError, Message, RecvError, Sample, Wait};

/// Receives messages of type `T` from all publishers of a topic, from each in turn.
///
/// Up to `depth` messages of each publisher wait to be taken; a newer message displaces the oldest
/// (SM2-QOS-001), unless the subscriber is reliable. A taken message is borrowed until its [`Sample`] is
/// dropped. While the program holds `max_borrowed` messages of a publisher, it gets no further ones
/// (SM2-MSG-005); other subscribers are not affected. Short messages [in cells](crate#how-a-message-travels) are
/// copies, which are not borrowed.
///
/// The subscriber's [descriptor](std::os::fd::AsFd) is readable when [`try_recv`](Self::try_recv) may have a
/// message: take messages until there is none, then poll again.
///
/// ```
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let lidar = domain.node("lidar")?;
/// # let scans = lidar.publisher_builder::<[f32]>("scan").latched(1).declare()?;
/// # scans.publish(&[1.0, 2.5])?;
/// # let node = domain.node("map")?;
/// let scans = node.subscriber_builder::<[f32]>("scan")
///     .depth(1)                                   // the newest message of each publisher only
///     .max_borrowed(1)
///     .declare()?;
/// let scan = scans.recv()?;                       // also: try_recv, recv_timeout
/// println!("{} ranges of {}, {} lost", scan.len(), scan.publisher(), scan.lost());
/// # Ok(())
/// # }
/// ```
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
    pub(crate) const fn handle(&self) -> &Handle {
        &self.handle
    }

    /// Waits for the next message, without a time limit. Waits also for a publisher, and while no Manager is
    /// running.
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

    /// Returns the next message, if one has arrived.
    ///
    /// # Errors
    ///
    /// See [`RecvError`].
    pub fn try_recv(&self) -> Result<Option<Sample<T>>, RecvError> {
        self.take(Until::NOW)
    }

    /// Waits for the next message, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// See [`RecvError`].
    pub fn recv_timeout(&self, timeout: Duration) -> Result<Option<Sample<T>>, RecvError> {
        self.take(Until::In(timeout))
    }

    fn take(&self, until: Until) -> Result<Option<Sample<T>>, RecvError> {
        let received = self.handle.receive(until, |interface, into, context| {
            interface
                .take(&mut |taken| *into = Some(taken), context)
                .map(drop)
        })?;
        received.map(Sample::new).transpose()
    }

    /// Takes all available messages, at most `most` and at most as many as the program may hold, and appends
    /// them to `samples`. Returns their number. Faster than taking them one by one.
    ///
    /// # Errors
    ///
    /// See [`RecvError`]. If several messages cannot be read, the last error is returned. All other messages
    /// are in `samples`.
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

    /// Waits for the first message, without a time limit, and then calls `each` with every available message:
    /// at most `most`, and at most as many as the program may [hold](SubscriberBuilder::max_borrowed).
    /// Releases all of them together, and returns their number.
    ///
    /// This is the fastest way to receive many short messages. `each` runs in this thread and may call the
    /// node. No message of the batch is released before the last call returns. For a message that cannot be
    /// read, `each` gets the error.
    ///
    /// # Errors
    ///
    /// See [`RecvError`]. After an error, no message was taken.
    pub fn recv_each(
        &self,
        most: usize,
        each: impl FnMut(Result<&Sample<T>, RecvError>),
    ) -> Result<usize, RecvError> {
        self.take_each(most, Until::Forever, each)
    }

    /// As [`recv_each`](Self::recv_each), but waits for at most `timeout`, and then returns 0.
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

    /// Returns how many messages were lost, of all publishers together. A loss counts once the next message
    /// of its publisher is taken, or once the publisher has a link again (see [`away`](Self::away)).
    pub fn lost(&self) -> u64 {
        (self.handle).with_driven(|interface, _| interface.reports.lost)
    }

    /// Returns how many of the [lost](Self::lost) messages were published while their publisher had no link with this
    /// subscriber, because the link had ended and a new one had not opened yet. The messages that an ended link did not
    /// bring any more are among them. They count when the new link opens, or with its first message if the publisher is
    /// latched (SM2-QOS-013).
    pub fn away(&self) -> u64 {
        (self.handle).with_driven(|interface, _| interface.reports.away)
    }

    /// Returns how many periods of the [deadline](SubscriberBuilder::deadline) have passed without a message, of all
    /// publishers together.
    pub fn missed_deadlines(&self) -> u64 {
        (self.handle).with_driven(|interface, _| interface.qos_counts().missed_deadlines)
    }

    /// Returns how often publishers stopped being alive, of all publishers together: see
    /// [`liveliness`](SubscriberBuilder::liveliness).
    pub fn lost_liveliness(&self) -> u64 {
        (self.handle).with_driven(|interface, _| interface.qos_counts().lost_liveliness)
    }
}

/// The quality of service of a subscriber.
#[derive(Debug)]
#[must_use = "a builder does nothing until declare is called"]
pub struct SubscriberBuilder<T: Message + ?Sized> {
    declaration: Declaration,
    /// `None` accepts every type.
    data: Option<TypeId>,
    demand: DemandedQos,
    receives: PhantomData<fn(&T)>,
}

impl<T: Message + ?Sized> SubscriberBuilder<T> {
    pub(crate) fn new(shared: &Arc<SharedNode>, topic: &str) -> Self {
        Self {
            declaration: Declaration::new(shared, topic),
            data: Some(T::type_id()),
            demand: DemandedQos::new(8, 4),
            receives: PhantomData,
        }
    }

    /// Sets how many messages of each publisher wait to be taken: 1 to 1,024; 8 by default.
    pub const fn depth(mut self, messages: u16) -> Self {
        self.demand.depth = messages;
        self
    }

    /// Requests reliable delivery; `false` by default. No message displaces another one: the publisher waits
    /// until this subscriber has room, for at most its
    /// [`publish_timeout`](crate::PublisherBuilder::publish_timeout) and within its
    /// [share](crate::PublisherBuilder::wait_share_percent) (SM2-QOS-002, SM2-QOS-004). A subscriber that missed a
    /// message is not waited for until it has released all messages that it had then (SM2-QOS-003). A gap is shown by
    /// [`Sample::lost`](crate::Sample::lost). A reliable subscriber matches only reliable publishers.
    pub const fn reliable(mut self, reliable: bool) -> Self {
        self.demand.reliable = reliable;
        self
    }

    /// Sets how many samples of each publisher the program may hold: 1 to 1,024; 4 by default. Samples of messages
    /// [in cells](crate#how-a-message-travels) do not count.
    ///
    /// A subscriber that needs only the latest message can use `depth(1).max_borrowed(1)`: its publishers
    /// then need the fewest slots. Drop each sample before you take the next one.
    pub const fn max_borrowed(mut self, messages: u16) -> Self {
        self.demand.max_borrowed = messages;
        self
    }

    pub(crate) fn topic(&self) -> &str {
        self.declaration.name()
    }

    /// Sets `max_borrowed` to this number, unless it is greater.
    pub(crate) fn hold_at_least(mut self, messages: u16) -> Self {
        self.demand.max_borrowed = self.demand.max_borrowed.max(messages);
        self
    }

    /// Demands a message of each publisher at least once in each `period`; no demand by default. Matches only
    /// publishers that offer a [deadline](crate::PublisherBuilder::deadline) of at most `period`.
    ///
    /// The first period of a publisher begins when its link opens. Each period that passes without a message counts
    /// as [missed](Subscriber::missed_deadlines) and is an [event](crate::Event::DeadlineMissed) (SM2-QOS-009).
    pub const fn deadline(mut self, period: Duration) -> Self {
        self.demand.deadline = Period::new(period);
        self
    }

    /// Demands a sign of life of each publisher's program at least once in each `lease`; no demand by default. Matches
    /// only publishers that offer a [liveliness](crate::PublisherBuilder::liveliness) of at most `lease`.
    ///
    /// When a lease passes without a message and without an
    /// [assertion](crate::Publisher::assert_liveliness), this is an [event](crate::Event::LivelinessLost) and counts
    /// as [lost](Subscriber::lost_liveliness). [`alive`](crate::diagnostics::LinkStatus::alive) of its link is `false`
    /// until the publisher [is alive again](crate::Event::LivelinessRegained) (SM2-QOS-011).
    pub const fn liveliness(mut self, lease: Duration) -> Self {
        self.demand.lease = Period::new(lease);
        self
    }

    max_len_setter!(
        "message",
        "A publisher sends no longer one to this subscriber, and counts it as \
         [`too_long`](sm2_proto::link::Counters::too_long) (SM2-QOS-008)."
    );
    wait_setter!("a message");
    sealed_setter!(
        demand,
        "Accepts only sealed messages, which their publisher cannot change after it has sent them."
    );

    /// Declares the subscriber, and waits for the Manager's answer.
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
            handle: self
                .declaration
                .declare(contract, PoolLimit::NONE, [schema_of::<T>()])?,
            receives: PhantomData,
        })
    }
}

impl SubscriberBuilder<[u8]> {
    /// Accepts messages of every type, as bytes; [`Sample::type_id`] returns the type.
    pub fn any_type(mut self) -> Self {
        self.data = None;
        self
    }

    /// Accepts messages of this type, as bytes.
    pub fn type_id(mut self, data: TypeId) -> Self {
        self.data = Some(data);
        self
    }
}
