//! The events of an interface that a program waits for in a wait set.

use super::{CallId, DeclaredInterface};
use crate::driver::context::Context;

/// An event of an interface that a program waits for.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Condition {
    /// A message or a request may be there.
    Message,
    /// The call is over.
    Call(CallId),
    /// There is an event for the program.
    Event,
    /// A publication would not wait.
    Room,
}

impl DeclaredInterface {
    /// Whether the program would find what it waits for.
    pub(crate) fn is_ready(&mut self, condition: Condition, context: &mut Context<'_>) -> bool {
        match condition {
            _ if self.is_closed => false,
            Condition::Message => self.links.may_take(),
            Condition::Call(call) => self.is_call_over(call, context),
            Condition::Event => self.reports.events.has_any(),
            Condition::Room => self.has_room(),
        }
    }
}
