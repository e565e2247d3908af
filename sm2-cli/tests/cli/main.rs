//! The `sm2` command as its users meet it: real processes, each test in a domain of its own.

mod common;
mod decoded;
mod demo;
mod doctor;
mod examples;
mod gateway;
mod generated;
mod help;
mod information;
mod lists;
mod measure;
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
