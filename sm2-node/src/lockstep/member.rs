//! The calls of a member to its conductor.

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use sm2_proto::lockstep::{Member, MemberInput, MemberOutput};
use sm2_proto::{Error, Machine};

use super::InputsError;
use super::message::{LockstepDone, LockstepTurn, SERVICE};
use crate::driver::SharedNode;
use crate::{CallError, Client, DeclareError, Event, Events, Node, WaitError};

/// The machine of a member, and its client.
pub(super) struct MemberDriver {
    client: Client<LockstepDone, LockstepTurn>,
    pub(super) events: Events,
    member: Member,
    shared: Arc<SharedNode>,
    /// Whether a link did not open in time: no turn waits for it again.
    is_stuck: bool,
}

/// How long a member waits for links that are being opened. A link of a program that does not run never opens.
const OPENING_MAX: Duration = Duration::from_secs(2);

impl MemberDriver {
    pub(super) fn new(node: &Node) -> Result<Self, DeclareError> {
        let client = node.client(SERVICE)?;
        Ok(Self {
            events: client.events(),
            client,
            member: Member::new(),
            shared: Arc::clone(&node.shared),
            is_stuck: false,
        })
    }

    /// Whether the service was found since the last call.
    pub(super) fn is_found(&self) -> Result<bool, InputsError> {
        loop {
            match self.events.try_next() {
                Ok(Some(Event::Joined { .. })) => return Ok(true),
                Ok(Some(_)) => {}
                Ok(None) => return Ok(false),
                Err(error) => return ended(error),
            }
        }
    }

    /// Waits until the service is found. Returns false after a shutdown.
    pub(super) fn wait_for_conductor(&self) -> Result<bool, InputsError> {
        loop {
            match self.events.next() {
                Ok(Event::Joined { .. }) => return Ok(true),
                Ok(_) => {}
                Err(error) => return ended(error),
            }
        }
    }

    /// Waits until no link of the node is being opened, so that the messages of the turn reach everybody. A member
    /// joins once its side of each link is open, so the other side is being opened then.
    pub(super) fn wait_for_links(&mut self) {
        let until = crate::now().after(OPENING_MAX);
        while self.shared.lock_driven().is_opening() {
            if self.is_stuck || crate::now() >= until {
                self.is_stuck = true;
                return;
            }
            thread::sleep(Duration::from_micros(100));
        }
        self.is_stuck = false;
    }

    /// Feeds the machine. Returns its work; `None` if the member is free again.
    pub(super) fn feed(&mut self, input: MemberInput) -> Result<Option<MemberOutput>, InputsError> {
        match self.member.handle(crate::now(), input) {
            Ok(()) => Ok(self.member.poll()),
            Err(Error::Ended(end)) => Err(end.into()),
            Err(Error::Misuse(misuse)) => unreachable!("{misuse}"),
        }
    }

    /// Calls the conductor, and waits for the next turn. `None` after a shutdown.
    pub(super) fn call(&self, done: LockstepDone) -> Result<Option<MemberInput>, InputsError> {
        match self.client.call(&done) {
            Ok(turn) => Ok(Some(MemberInput::Turn((*turn).into()))),
            Err(CallError::Shutdown { .. }) => Ok(None),
            Err(CallError::Io { source, .. }) => Err(InputsError::Io(source)),
            Err(error) => {
                tracing::info!(%error, "the lockstep is over: inputs are handled as they arrive");
                Ok(Some(MemberInput::Failed))
            }
        }
    }
}

/// The result of a wait that ended: `false` after a shutdown.
pub(super) fn ended(error: WaitError) -> Result<bool, InputsError> {
    match error {
        WaitError::Io(error) => Err(InputsError::Io(error)),
        _ => Ok(false),
    }
}
