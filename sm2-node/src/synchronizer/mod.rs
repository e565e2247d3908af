//! Messages of several topics that belong together: see [`Synchronizer`].

mod approximate;
mod builder;
mod core;
mod exact;
mod input;
mod queues;
mod sets;
#[cfg(test)]
mod tests;
mod tuples;
mod waiting;

pub use self::builder::{QUEUE_MAX, SynchronizerBuilder};
pub use self::input::{Input, IntoInput};
pub use self::queues::InputCounters;
pub use self::sets::Synchronizer;
pub use self::tuples::InputTuple;
