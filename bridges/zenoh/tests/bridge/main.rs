//! Tests of the bridge with real sessions of Zenoh, over TCP.

mod common;
mod durable;
mod explain;
mod fleet;
mod plain;
mod plain_services;
mod program;
mod ring;
mod ros2;
mod services;
mod stalled;
mod twice;
