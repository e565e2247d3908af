//! The `sm2` command as its users meet it: real processes, each test in a domain of its own.

mod common;
mod demo;
mod help;
mod lists;
mod signals;
mod transfer;
mod wrong;
