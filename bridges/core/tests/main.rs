//! Tests of the parts that all bridges share.

mod fleet;
mod outbox;
mod spool;
