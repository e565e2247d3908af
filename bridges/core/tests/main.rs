//! Tests of the parts that all bridges share.

mod fleet;
mod inbound;
mod outbox;
mod spool;
