//! Tests of the `sm2` command with real processes, each in its own domain.

mod bag;
mod black_box;
mod common;
mod decoded;
mod demo;
mod doctor;
mod examples;
mod gateway;
mod generated;
mod help;
mod information;
mod kills;
mod lists;
mod max_len;
mod measure;
mod policy;
mod services;
mod signals;
mod snapshot;
mod takeover;
mod top;
mod transfer;
mod unknown;
mod waiting;
mod why;
mod wrong;
