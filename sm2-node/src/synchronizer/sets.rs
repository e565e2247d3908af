//! The sets of messages that belong together.

use std::fmt;
use std::sync::Arc;

use sm2_io::Waker;
use sm2_proto::Name;

use super::core::Core;
use super::queues::{InputCounters, Output};
use super::tuples::Slots;
use crate::driver::SharedInterface;
use crate::{RecvError, Shutdown, WaitSet};

/// Takes the messages of two to eight topics, and returns sets of messages that belong together by their times: one of
/// each topic. `S` is the tuple of their [samples](crate::Sample), so no message is copied.
///
/// ```
/// use sm2_node::Synchronizer;
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let domain = sm2_node::testing::TestDomain::new()?;
/// # let node = domain.node("detector")?;
/// # let camera = node.publisher::<[u8]>("image")?;
/// # let lidar = node.publisher::<[f64]>("scan")?;
/// let images = node.subscriber_builder::<[u8]>("image");
/// let scans = node.subscriber_builder::<[f64]>("scan");
/// let mut synchronizer = Synchronizer::approximate((images, scans)).queue(8).declare()?;
/// # camera.wait_for_subscribers(1)?;
/// # lidar.wait_for_subscribers(1)?;
/// # for _ in 0..2 {
/// #     lidar.publish(&[1.0, 2.0])?;
/// #     camera.publish(&[0; 100])?;
/// # }
/// let (image, scan) = synchronizer.recv()?;
/// println!("{} bytes, {} distances", image.len(), scan.len());
/// # Ok(())
/// # }
/// ```
///
/// A [`WaitSet`](crate::WaitSet::add_synchronizer) and an [executor](crate::executor::Group::on_set) wait for sets
/// together with other things. The inputs are builders, because the synchronizer declares subscribers that may hold as
/// many messages as it needs.
///
/// The time of a message is that of its publication, or comes from a [function](super::Input::time) of the program.
///
/// # Exact times
///
/// An [exact](Self::exact) synchronizer makes a set of messages whose times are equal, such as those of nodes that copy
/// the time of the image that they were computed from. Each set is made as soon as its last message is there.
/// A message is dropped as soon as its set cannot be completed any more: when another input has a later one.
///
/// # Approximate times
///
/// An [approximate](Self::approximate) synchronizer uses the algorithm `ApproximateTime` of ROS 2's `message_filters`,
/// with its queues, its pivot, its lower bound of the time between messages, its age penalty and its longest interval.
/// The pivot of a set is the latest among the oldest messages that are left of each input. While no queue overflows,
/// the algorithm promises:
///
/// - The sets depend on the times of the messages alone, not on the order in which different topics arrive.
/// - Each message is in at most one set. Sets do not cross: of two sets, one has the earlier or the same time in every
///   input, and no message is skipped that is in a later set.
/// - Without an [age penalty](super::SynchronizerBuilder::age_penalty_percent), a set has the shortest interval of all
///   that contain the pivot, of the messages that are left; among equal intervals, the earliest. With a penalty, a
///   later set is preferred only if it is that much better.
/// - No set is longer than [`max_interval`](super::SynchronizerBuilder::max_interval).
///
/// A set is returned when no later message can make a better one, which usually takes the next message of an input, or
/// less with an [`Input::min_period`](super::Input::min_period).
///
/// # Differences from ROS 2
///
/// A message whose time is before that of its predecessor on the same input is dropped, and counted. An exact
/// synchronizer bounds the messages of each input, and not the incomplete sets. Each message that is not used
/// is [counted](Self::counters) with its reason. After the clock of the messages has jumped back, such as in a replay
/// that begins again, call [`clear`](Self::clear).
///
/// # Memory
///
/// The synchronizer holds at most [`queue`](super::SynchronizerBuilder::queue) messages of each input, and one more
/// during a call. Its subscribers may hold so many messages, and those of
/// [`sets_held`](super::SynchronizerBuilder::sets_held) sets in the hand of the program. While the program holds more
/// sets than that, calls may return [`RecvError::TooManyBorrowed`].
pub struct Synchronizer<S> {
    slots: Slots<S>,
    core: Core,
    /// The inputs in the order in which they are asked for a message.
    order: Vec<usize>,
    bell: Bell,
    /// The wait set of the calls that wait for this synchronizer only; `None` before the first one.
    pub(super) own_set: Option<WaitSet<'static, ()>>,
}

/// Makes wait sets look again for sets that no further message completes.
#[derive(Debug, Default)]
struct Bell {
    /// `None` before the synchronizer was added to a wait set.
    waker: Option<Arc<Waker>>,
    is_rung: bool,
}

impl<S> Synchronizer<S> {
    pub(super) fn new(slots: Slots<S>, core: Core) -> Self {
        Self {
            order: (0..slots.iter().count()).collect(),
            slots,
            core,
            bell: Bell::default(),
            own_set: None,
        }
    }

    /// Returns the next set, if the messages that have arrived make one.
    ///
    /// # Errors
    ///
    /// As [`Subscriber::try_recv`](crate::Subscriber::try_recv). The next call goes on with the next message.
    pub fn try_recv(&mut self) -> Result<Option<S>, RecvError> {
        loop {
            if let Some(set) = self.next_set() {
                // Further sets need no further message, so no input would wake a wait set for them.
                if self.core.has_output() {
                    self.bell.ring();
                }
                return Ok(Some(set));
            }
            if !self.take_message()? {
                self.bell.clear();
                return Ok(None);
            }
        }
    }

    /// The name of the topic of an input, counted from 0.
    #[must_use]
    pub fn topic(&self, input: usize) -> Option<&Name> {
        self.slots.0.slot(input).map(|it| it.topic())
    }

    /// The fates of the messages of an input, counted from 0.
    #[must_use]
    pub fn counters(&self, input: usize) -> Option<InputCounters> {
        (input < self.order.len()).then(|| self.core.counters(input))
    }

    /// The number of sets that were returned.
    #[must_use]
    pub const fn sets(&self) -> u64 {
        self.core.sets()
    }

    /// Drops all messages that are held, as unmatched, and forgets the times that have come: for a clock that has
    /// jumped back.
    pub fn clear(&mut self) {
        while self.next_set().is_some() {}
        self.core.clear();
        self.next_set();
    }

    pub(crate) fn topics(&self) -> Vec<Name> {
        self.slots.iter().map(|it| it.topic().clone()).collect()
    }

    pub(super) fn interfaces(&self) -> impl Iterator<Item = &Arc<SharedInterface>> {
        self.slots.iter().map(|it| it.interface())
    }

    /// The shutdowns that end the waits of the nodes.
    pub(super) fn shutdowns(&self) -> impl Iterator<Item = &Shutdown> {
        self.slots.iter().filter_map(|it| it.shutdown())
    }

    /// The descriptor that is readable while there is a set that no further message completes.
    pub(super) fn bell(&mut self) -> std::io::Result<Arc<Waker>> {
        let waker = match &self.bell.waker {
            Some(waker) => Arc::clone(waker),
            None => Arc::new(Waker::new()?),
        };
        self.bell.waker = Some(Arc::clone(&waker));
        if self.core.has_output() {
            self.bell.ring();
        }
        Ok(waker)
    }

    /// Does the work for messages that were handled, up to the next set.
    fn next_set(&mut self) -> Option<S> {
        let mut set = None;
        while let Some(output) = self.core.poll() {
            self.drop_message(output);
            if output == Output::Set {
                set = self.slots.0.take_set();
                break;
            }
        }
        // Memory is given back as soon as possible.
        while let Some(output) = self.core.poll_drop() {
            self.drop_message(output);
        }
        set
    }

    fn drop_message(&mut self, output: Output) {
        match output {
            Output::DropOldest(input) => {
                if let Some(slot) = self.slots.0.slot_mut(input) {
                    slot.drop_oldest();
                }
            }
            Output::DropNewest(input) => {
                if let Some(slot) = self.slots.0.slot_mut(input) {
                    slot.drop_newest();
                }
            }
            Output::Set => {}
        }
    }

    /// Takes a message of any input. The input that is behind the others comes first, so that none fills its queue
    /// while another one still has the messages for it.
    fn take_message(&mut self) -> Result<bool, RecvError> {
        let core = &self.core;
        self.order.sort_by_key(|&input| core.newest(input));
        for &input in &self.order {
            let Some(slot) = self.slots.0.slot_mut(input) else {
                continue;
            };
            if let Some(time) = slot.take()? {
                self.core.handle(input, time);
                return Ok(true);
            }
        }
        Ok(false)
    }
}

impl Bell {
    fn ring(&mut self) {
        if let Some(waker) = &self.waker {
            self.is_rung = true;
            waker.wake();
        }
    }

    fn clear(&mut self) {
        if let (true, Some(waker)) = (self.is_rung, &self.waker) {
            self.is_rung = false;
            waker.drain();
        }
    }
}

impl<S> fmt::Debug for Synchronizer<S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Synchronizer")
            .field("topics", &self.topics())
            .field("sets", &self.sets())
            .finish_non_exhaustive()
    }
}
