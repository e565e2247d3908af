//! Inputs of a node that gives the same outputs in each replay (SPEC section 16.2).
//!
//! [`Inputs`] has all subscribers and timers of a node, and handles them in one thread. It takes messages until none is
//! left, handles the first one in the order of SM2-LCK-005, and takes again, so the order does not depend on
//! `max_borrowed`. If a message is lost or comes late, the member ends: an error is better than outputs that cannot be
//! repeated. The conductor is part of the player of `sm2-bag`, which is the source of domain time as well.

mod error;
mod inputs;
mod member;
mod message;
mod subscription;
mod ticks;

pub use self::error::InputsError;
pub use self::inputs::Inputs;
#[doc(hidden)]
pub use self::message::{LockstepDone, LockstepTurn, SERVICE};
