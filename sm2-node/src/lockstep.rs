//! Inputs of a node that gives the same outputs in each replay (SPEC section 16.2).

mod error;
mod inputs;
mod message;
mod session;
mod subscription;
mod ticks;

pub use self::error::InputsError;
pub use self::inputs::Inputs;
#[doc(hidden)]
pub use self::message::{LockstepDone, LockstepTurn, SERVICE};
