//! Tests of the bridge with real sessions of Zenoh, over TCP.

mod common;
mod durable;
mod plain;
mod ros2;
mod services;
