//! The inputs of a node, in one thread.

use std::env;
use std::hint;
use std::io;
use std::time::Duration;

use sm2_proto::Instant;
use sm2_proto::clock::DomainTime;
use sm2_proto::lockstep::{MemberInput, MemberOutput, Turn};

use super::InputsError;
use super::member::{MemberDriver, ended};
use super::subscription::{Callback, Place, Subscription};
use super::ticks::Ticks;
use crate::clock::Clock;
use crate::executor::Failure;
use crate::{Message, Name, Node, Sample, Subscriber, Tick, WaitSet};

/// All inputs of a node that gives the same outputs in each replay: messages and ticks of domain time, handled in one
/// thread by callbacks that share a state.
///
/// Without a conductor, such as on a robot, inputs are handled as they arrive. While the domain has a conductor, such
/// as `sm2 play --lockstep`, the node is a *member* of its lockstep: the messages and ticks of each turn come in a
/// fixed order, and domain time stands still until the node has handled them. The outputs then do not depend on the
/// speed of any process, provided that the callbacks depend on their arguments alone: on `now`, and neither on the
/// machine's clocks nor on the order of entries in a `HashMap`.
///
/// ```no_run
/// use std::time::Duration;
/// use sm2_node::lockstep::Inputs;
/// use sm2_node::{Node, Publisher};
///
/// struct Filter {
///     mean: f32,
///     output: Publisher<f32>,
/// }
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let node = Node::new("filter")?;
/// let mut state = Filter { mean: 0.0, output: node.publisher("mean")? };
/// let scans = node.subscriber_builder::<f32>("distance").reliable(true).depth(64).declare()?;
///
/// let mut inputs = Inputs::new(&node)?;
/// inputs.on_message(scans, |state: &mut Filter, distance, _now| {
///     state.mean += (*distance - state.mean) / 8.0;
///     Ok(())
/// })?;
/// inputs.on_tick(Duration::from_millis(100), |state: &mut Filter, _tick, _now| {
///     state.output.publish(&state.mean)?;
///     Ok(())
/// });
/// inputs.run(&mut state)?;
/// # Ok(())
/// # }
/// ```
///
/// # The order of a turn
///
/// First the messages: by topic, then by the name of the publisher's node, then by the time of publication. Then the
/// ticks, by time. Messages that a member publishes in a turn are inputs of the next turn at the same domain time.
///
/// A subscriber needs room for the messages of one turn: at most `depth` of each publisher. If one is lost or comes
/// too late, [`run`](Self::run) returns an error instead of outputs that cannot be repeated.
pub struct Inputs<'a, S> {
    member: MemberDriver,
    clock: Clock,
    subscriptions: Vec<Box<dyn Subscription<S> + 'a>>,
    ticks: Ticks<'a, S>,
    set: WaitSet<'static, ()>,
    /// Whether nothing is handled without a conductor.
    only_in_lockstep: bool,
    /// The cut of the turn before; `None` before the first turn.
    last_cut: Option<Instant>,
}

/// The environment variable that sets [`Inputs::only_in_lockstep`].
const ONLY_IN_LOCKSTEP: &str = "SM2_LOCKSTEP";

impl<'a, S> Inputs<'a, S> {
    /// Inputs of a node, without callbacks. The node's [shutdown](crate::NodeBuilder::shutdown) ends them.
    ///
    /// # Errors
    ///
    /// [`InputsError::Declare`], [`InputsError::Io`].
    pub fn new(node: &Node) -> Result<Self, InputsError> {
        let member = MemberDriver::new(node)?;
        let clock = node.clock()?;
        let set = Self::wait_set(node, &member, &clock);
        Ok(Self {
            member,
            clock,
            subscriptions: Vec::new(),
            ticks: Ticks::default(),
            set: set.map_err(InputsError::Io)?,
            only_in_lockstep: env::var_os(ONLY_IN_LOCKSTEP).is_some_and(|it| it == "on"),
            last_cut: None,
        })
    }

    /// Sets whether inputs wait for a conductor. By default they are handled as they arrive while there is none, unless
    /// the environment variable `SM2_LOCKSTEP` is `on`. A replay that has to give the same outputs from the first
    /// message on needs this: otherwise timers tick by the wall clock until the node has joined.
    pub fn only_in_lockstep(&mut self, only: bool) {
        self.only_in_lockstep = only;
    }

    fn wait_set(
        node: &Node,
        member: &MemberDriver,
        clock: &Clock,
    ) -> io::Result<WaitSet<'static, ()>> {
        let mut set = WaitSet::new()?;
        set.add(&member.events, ())?;
        set.add(clock, ())?;
        if let Some(shutdown) = node.shared.sets.shutdown_handle() {
            set.end_with(shutdown)?;
        }
        Ok(set)
    }

    /// Calls `callback` for each message of a subscriber, with the state, the message and the domain time.
    ///
    /// # Errors
    ///
    /// As [`WaitSet::add`].
    pub fn on_message<T: Message + ?Sized + 'a>(
        &mut self,
        subscriber: Subscriber<T>,
        callback: impl FnMut(&mut S, Sample<T>, DomainTime) -> Result<(), Failure> + 'a,
    ) -> io::Result<()> {
        self.set.add(&subscriber, ())?;
        self.subscriptions.push(Box::new(Callback {
            subscriber,
            callback,
            taken: Vec::new(),
        }));
        Ok(())
    }

    /// Calls `callback` once in each period of domain time, with the state, the tick and the domain time. In lockstep,
    /// the first tick is due one period after the first turn, and else one period from now.
    pub fn on_tick(
        &mut self,
        period: Duration,
        callback: impl FnMut(&mut S, Tick, DomainTime) -> Result<(), Failure> + 'a,
    ) {
        self.ticks.add(period, &self.clock, Box::new(callback));
    }

    /// Handles inputs until the node's shutdown, or until a callback returns an error.
    ///
    /// # Errors
    ///
    /// See [`InputsError`].
    pub fn run(mut self, state: &mut S) -> Result<(), InputsError> {
        self.subscriptions.sort_by(|a, b| a.topic().cmp(b.topic()));
        loop {
            let is_found = match self.only_in_lockstep {
                true => self.member.wait_for_conductor()?,
                false => self.run_free(state)?,
            };
            if !is_found || !self.run_in_lockstep(state)? {
                return Ok(());
            }
        }
    }

    /// Handles inputs as they arrive, until the service is found. Returns false after a shutdown.
    fn run_free(&mut self, state: &mut S) -> Result<bool, InputsError> {
        loop {
            while self.handle_free(state)? {}
            if self.member.is_found()? {
                return Ok(true);
            }
            let left = self.ticks.deadline(&self.clock);
            let left = left.map(|it| it.since(crate::now()));
            let waited = match left {
                Some(left) => self.set.wait_timeout(left),
                None => self.set.wait().map(Some),
            };
            if let Err(error) = waited {
                return ended(error);
            }
        }
    }

    /// Handles one message of each subscriber, and one tick. Returns whether there was one.
    fn handle_free(&mut self, state: &mut S) -> Result<bool, InputsError> {
        let now = self.clock.now();
        let mut handled = false;
        for subscription in &mut self.subscriptions {
            handled |= subscription.handle_next(state, now)?;
        }
        self.ticks.follow(&self.clock);
        let ticked = self.ticks.handle_next(state, now);
        Ok(handled | ticked.map_err(InputsError::Callback)?)
    }

    /// Handles inputs in turns, until the conductor is gone. Returns false after a shutdown.
    fn run_in_lockstep(&mut self, state: &mut S) -> Result<bool, InputsError> {
        self.member.wait_for_links();
        self.last_cut = None;
        let mut input = MemberInput::Found;
        loop {
            input = match self.member.feed(input)? {
                Some(MemberOutput::Call(done)) => match self.member.call(done.into())? {
                    Some(input) => input,
                    None => return Ok(false),
                },
                Some(MemberOutput::Work(turn)) => MemberInput::Finished {
                    taken: self.handle_turn(turn, state)?,
                    next: self.ticks.next(),
                },
                None => {
                    self.ticks.restart(self.clock.now());
                    return Ok(true);
                }
            };
        }
    }

    /// Handles the inputs of a turn. Returns their number.
    //= SM2-LCK-005
    fn handle_turn(&mut self, turn: Turn, state: &mut S) -> Result<u64, InputsError> {
        self.member.wait_for_links();
        if self.last_cut.is_none() {
            self.ticks.restart(turn.time);
        }
        // Everything that is published from here on belongs to the next turn.
        while crate::now() <= turn.cut {
            hint::spin_loop();
        }
        let mut taken = 0;
        for subscription in &mut self.subscriptions {
            let mut last = None;
            loop {
                subscription.take(turn.cut).map_err(InputsError::Receive)?;
                let Some((index, place)) = subscription.first(turn.cut) else {
                    break;
                };
                let lost = subscription.lost_before(index);
                let topic = subscription.topic();
                check(topic, &place, lost, last.as_ref(), self.last_cut)?;
                let handled = subscription.handle(index, state, turn.time);
                handled.map_err(InputsError::Callback)?;
                taken += 1;
                last = Some(place);
            }
        }
        while (self.ticks.handle_next(state, turn.time)).map_err(InputsError::Callback)? {
            taken += 1;
        }
        self.last_cut = Some(turn.cut);
        Ok(taken)
    }
}

/// Refuses a message that is not the next one of its subscriber: after those that were handled before in this turn, or
/// in earlier ones, and with no lost message before it.
//= SM2-LCK-006
fn check(
    topic: &Name,
    place: &Place,
    lost: u64,
    last: Option<&Place>,
    last_cut: Option<Instant>,
) -> Result<(), InputsError> {
    let (publisher, time, _) = place;
    if last.is_some_and(|last| place < last) || last_cut.is_some_and(|cut| *time <= cut) {
        return Err(InputsError::Late {
            topic: topic.clone(),
            publisher: publisher.clone(),
        });
    }
    // Messages before the first turn need not be there.
    if lost > 0 && last_cut.is_some() {
        return Err(InputsError::Lost {
            topic: topic.clone(),
            publisher: publisher.clone(),
            lost,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(publisher: &str, time: u64) -> Place {
        (Name::new(publisher).unwrap(), Instant(time), 1)
    }

    //= SM2-LCK-006 test
    #[test]
    fn a_message_of_another_place_is_an_error() {
        let topic = Name::new("scan").unwrap();
        let b9 = place("b", 9);
        let is_late = |last: Option<&Place>, last_cut| {
            let checked = check(&topic, &b9, 0, last, last_cut);
            matches!(checked, Err(InputsError::Late { .. }))
        };
        assert!(!is_late(None, None));
        assert!(!is_late(None, Some(Instant(8))));
        assert!(is_late(None, Some(Instant(9))));
        assert!(!is_late(Some(&place("a", 10)), Some(Instant(8))));
        assert!(!is_late(Some(&place("b", 8)), Some(Instant(7))));
        assert!(is_late(Some(&place("b", 10)), Some(Instant(8))));
        assert!(is_late(Some(&place("c", 8)), Some(Instant(7))));
    }

    //= SM2-LCK-006 test
    #[test]
    fn a_lost_message_is_an_error_after_the_first_turn() {
        let topic = Name::new("scan").unwrap();
        let checked = |last_cut| check(&topic, &place("a", 9), 3, None, last_cut);
        assert!(checked(None).is_ok());
        let error = checked(Some(Instant(8))).unwrap_err();
        assert!(
            matches!(error, InputsError::Lost { lost: 3, .. }),
            "{error}"
        );
    }
}
