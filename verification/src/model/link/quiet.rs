//! The properties that hold in every moment, and those that hold when no action is left.

use sm2_proto::{
    Datagram, Farewell, Machine,
    link::{Error, Fate, Input, Link, NoMemory, Role},
};

use super::{
    super::{Failure, Property},
    Action, LinkScope, World,
    books::{FlowLimits, Room},
    fail,
    world::{End, Life, NOW},
};

impl World {
    /// Checks this moment, when `actions` are possible. Returns whether it is quiet.
    ///
    /// # Errors
    ///
    /// The first property that does not hold.
    pub fn check(&self, scope: &LinkScope, actions: &[Action]) -> Result<bool, Failure> {
        for (at, end) in self.ends.iter().enumerate() {
            if end.life != Life::Dead {
                self.check_books(scope, at, end)?;
                self.check_limit(scope, at, end)?;
                check_silence(at, end)?;
            }
        }
        if actions.iter().any(|it| it.goes_on()) {
            return Ok(false);
        }
        for (at, end) in self.ends.iter().enumerate() {
            if end.life != Life::Dead {
                self.check_quiet(at, end)?;
            }
        }
        Ok(true)
    }

    /// The counters of the machine agree with the plain lists.
    //= SM2-QOS-006 model
    fn check_books(&self, scope: &LinkScope, at: usize, end: &End) -> Result<(), Failure> {
        let (link, flow) = (&end.link, &self.flows[at]);
        let (counted, wanted) = (link.counters(), flow.counters());
        if counted != wanted {
            let what = format!("end {at} counts {counted:?}, not {wanted:?}");
            return fail(Property::FatesAreTrue, what);
        }
        if link.owes() != (end.over.is_none() && flow.owes()) {
            let what = format!("end {at} owes: {}", link.owes());
            return fail(Property::DebtIsTrue, what);
        }
        let sends = scope.config(at).role != Role::Receiver && end.over.is_none();
        let room = self.room(scope, at) == Room::Free;
        if sends && link.has_room(&NoMemory) != room {
            let what = format!(
                "end {at} has room: {}, not {room}",
                link.has_room(&NoMemory)
            );
            return fail(Property::MessagesInOrder, what);
        }
        let ready = self.flows[1 - at].ready();
        if link.untaken(&NoMemory) != ready {
            let what = format!(
                "at end {at} {} are ready, not {ready}",
                link.untaken(&NoMemory)
            );
            return fail(Property::MessagesInOrder, what);
        }
        let calls = end.calls.len() + self.replies_that_wait(at);
        if end.over.is_none() && link.calls() != calls {
            let what = format!("end {at} has {} calls, not {calls}", link.calls());
            return fail(Property::CallsEndOnce, what);
        }
        Ok(())
    }

    /// An application that holds `max_borrowed` messages gets no more.
    //= SM2-MSG-005 model
    fn check_limit(&self, scope: &LinkScope, at: usize, end: &End) -> Result<(), Failure> {
        let flow = &self.flows[1 - at];
        if flow.ready() == 0 || flow.may_take(&FlowLimits::new(scope, 1 - at)) {
            return Ok(());
        }
        match end.link.clone().take(&NoMemory) {
            Err(_) => Ok(()),
            Ok(more) => fail(Property::WithinWindow, format!("end {at} gives {more:?}")),
        }
    }

    fn check_quiet(&self, at: usize, end: &End) -> Result<(), Failure> {
        let (link, other) = (&end.link, &self.ends[1 - at]);
        //= SM2-SRV-002, SM2-SRV-004 model
        if !end.calls.is_empty() || link.calls() > 0 {
            let what = format!("calls {:?} of end {at} never end", end.calls);
            return fail(Property::CallsEndOnce, what);
        }
        //= SM2-PAY-005, SM2-MSG-004, SM2-OPN-009 model
        if !end.pool.all_back() || !end.files.is_empty() || !end.held.is_empty() {
            let what = format!("end {at} has slots {:?}, files {:?}", end.pool, end.files);
            return fail(Property::SlotsComeBack, what);
        }
        let both = (
            end.over.is_some(),
            other.over.is_some() || other.life == Life::Dead,
        );
        let at_rest = match both {
            (true, true) => end.mapped.is_empty(),
            (false, false) => link.is_open() && !link.owes() && end.kept.is_none(),
            _ => false,
        };
        let done = self.flows.iter().all(|it| it.entries.is_empty());
        if at_rest && done && self.wires[at].queue.is_empty() && link.in_flight() == 0 {
            return Ok(());
        }
        let left = self.flows.each_ref().map(|it| &it.entries);
        let what = format!("end {at} is {:?}, {left:?} are left", end.over);
        fail(Property::LinkComesToRest, what)
    }

    /// The number of replies that have not left the server's machine, which count as calls.
    fn replies_that_wait(&self, at: usize) -> usize {
        match at {
            1 => self.flows[1].queued().count(),
            _ => 0,
        }
    }
}

/// Checks that an end that is over ignores all inputs, and keeps its reason.
//= SM2-OPN-007, SM2-OPN-009 model
fn check_silence(at: usize, end: &End) -> Result<(), Failure> {
    let Some(reason) = end.over else {
        return Ok(());
    };
    let inputs = [
        Input::Eof,
        Input::Writable,
        Input::Close(Farewell::Stalled.code()),
        Input::Datagram(Datagram::new(&[9, 0, 0, 0, 0, 0, 0, 0])),
        Input::Datagram(Datagram::new(&[0])),
        Input::Cancel { call: 1 },
        Input::Retire { segment: 0 },
        Input::Drop(Fate::NoRoom),
    ];
    let mut link: Link = end.link.clone();
    for input in inputs {
        let what = format!("end {at} is over, and answers {input:?}");
        let answer = link.handle(NOW, input);
        if answer != Err(Error::Ended(reason)) || link.poll().is_some() || link != end.link {
            return fail(Property::SilentAfterEnd, what);
        }
    }
    Ok(())
}
