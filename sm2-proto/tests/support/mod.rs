//! Helpers that several tests share.
#![allow(dead_code, reason = "each test uses a part")]

pub(crate) mod access;
pub(crate) mod bench;
mod cases;
pub(crate) mod contracts;
pub(crate) mod edit;
pub(crate) mod items;
pub(crate) mod matching;
pub(crate) mod onlooker;
pub(crate) mod oracle;
pub(crate) mod session;
pub(crate) mod world;

pub(crate) use cases::cases;
