//! Tests of the bridge with real sessions of Zenoh, over TCP.

mod common;
mod plain;
mod ros2;
mod services;
