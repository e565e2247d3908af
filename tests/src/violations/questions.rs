//! Violations by a node in its requests: watching, counters, schemas.

use std::os::fd::{AsFd, OwnedFd};

use sm2_proto::{
    Seals,
    ViolationKind::{
        BadSchema, BadSize, CountersTwice, NotAMemfd, ReloadTwice, SealsMissing,
        UnexpectedSuspended, WatchTwice,
    },
};

use super::manager_rows::{Rows, Rule, all};
use crate::{
    control::{self, type_id},
    memory,
    raw::RawNode,
};

impl RawNode {
    fn give_counters(&self, file: &OwnedFd) {
        self.ready();
        self.send_fds(control::counters(), &[file.as_fd()]);
    }
}

impl Rule {
    /// COUNTERS with this file.
    fn counters(self, what: &str, file: impl Fn() -> OwnedFd + 'static) -> Self {
        self.row(format!("COUNTERS {what}"), move |node| {
            node.give_counters(&file());
        })
    }

    /// SCHEMA of a type with this hash.
    fn schema(self, what: &str, hash: u64, text: &'static str) -> Self {
        self.row(format!("SCHEMA {what}"), move |node| {
            node.ready();
            node.send(control::schema(&type_id("t", hash), text));
        })
    }
}

/// The rows; each starts with a new connection that has not greeted.
pub(super) fn rows() -> Rows {
    let watch = Rule::new(WatchTwice, "SM2-WCH-001").row("WATCH twice", |node| {
        node.ready();
        // The revision does not change again. Either the second WATCH arrives before the answer to the
        // first one, or that answer was sent at once and the third WATCH arrives before the second one's.
        node.send(control::query());
        let revision = node.revision();
        node.send(control::watch(revision));
        node.send(control::watch(revision));
    });
    let twice = Rule::new(CountersTwice, "SM2-CNT-001").row("COUNTERS twice", |node| {
        let file = memory::segment(1_024);
        node.give_counters(&file);
        node.send_fds(control::counters(), &[file.as_fd()]);
    });
    let reload = Rule::new(ReloadTwice, "SM2-ACC-016").row("RELOAD twice", |node| {
        node.ready();
        // Some RELOAD comes before the answer to the one before.
        while node.peer().try_send(&control::reload(), &[]).is_ok() {}
    });
    let suspended = Rule::new(UnexpectedSuspended, "SM2-ACC-014")
        .row("SUSPENDED of an interface that there is not", |node| {
            node.ready();
            node.send(control::suspended(7));
        })
        .row("SUSPENDED of an interface that is live", |node| {
            node.ready();
            node.declare(7, &control::publisher("s", control::Qos::PLAIN));
            node.send(control::suspended(7));
        });
    all([watch, twice, reload, suspended])
        .into_iter()
        .chain(files())
        .chain(schemas())
        .collect()
}

fn files() -> Rows {
    let kind = Rule::new(NotAMemfd, "SM2-CNT-001")
        .counters("with /dev/null", memory::null)
        .counters("that is open for writing alone", || {
            memory::write_only(&memory::segment(1_024))
        });
    let mut seals = Rule::new(SealsMissing, "SM2-CNT-001");
    for (what, seal) in [
        ("without SEAL", Seals::SEAL),
        ("without SHRINK", Seals::SHRINK),
        ("without GROW", Seals::GROW),
        ("without FUTURE_WRITE", Seals::FUTURE_WRITE),
    ] {
        seals = seals.counters(what, move || {
            memory::memfd(1_024, memory::without(Seals::POOLED, seal))
        });
    }
    let mut size = Rule::new(BadSize, "SM2-CNT-001");
    for len in [0, 512, 1_023, 1_025, 4_194_304 + 512] {
        size = size.counters(&format!("of {len} bytes"), move || memory::segment(len));
    }
    all([kind, seals, size])
}

fn schemas() -> Rows {
    let long: &'static str = Box::leak("x".repeat(32_769).into_boxed_str());
    let rule = Rule::new(BadSchema, "SM2-SCH-001")
        .schema("without text", 0, "")
        .schema("that is none", 1, "plain:struct{")
        .schema("whose hash is not the type's", 1, "plain:u8")
        .schema("of 32,769 bytes", 1, long);
    all([rule])
}
