//! Makes modules from shipped sources: unchanged, and with one fault each.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs};

/// A name, a text that occurs exactly once in the source, and its replacement.
type Change = (&'static str, &'static str, &'static str);

/// A name, and several replacements that are made together.
type Together = (&'static str, &'static [(&'static str, &'static str)]);

/// Faults of the seqlock. `tests/counters.rs` expects each to be found.
const SEQLOCK: &[Change] = &[
    (
        "no_release_fence",
        "        fence(Ordering::Release);\n",
        "",
    ),
    (
        "relaxed_end",
        "self.words[TURN].store(self.turn.to_le(), Ordering::Release);",
        "self.words[TURN].store(self.turn.to_le(), Ordering::Relaxed);",
    ),
    (
        "no_odd_turn",
        "        words[TURN].store(turn.to_le(), Ordering::Relaxed);\n",
        "",
    ),
    ("odd_taken", "if turn % 2 == 1 {", "if false {"),
    ("no_second_look", "if word(TURN) != turn {", "if false {"),
    (
        "no_first_acquire",
        "    fence(Ordering::Acquire);\n    let mut copied",
        "    let mut copied",
    ),
    (
        "no_second_acquire",
        "    fence(Ordering::Acquire);\n    if word(TURN)",
        "    if word(TURN)",
    ),
];

/// Faults of the waiting. `tests/sleepers.rs` expects each to be found.
const WAIT: &[Change] = &[
    ("no_wake", "sleeper.waker.wake();", ""),
    (
        "entered_late",
        "            let waker = inner.sleepers.enter(topic)?;\n            drop(inner);\n",
        "            drop(inner);\n            let waker = self.lock().sleepers.enter(topic)?;\n",
    ),
    (
        "no_sockets",
        "[self.epoll.as_fd(), waker.as_fd()]",
        "[waker.as_fd()]",
    ),
    (
        "own_topic_only",
        "(sleeper.topic == topic || topic == Topic::Session)",
        "sleeper.topic == topic",
    ),
    ("woken_for_ever", "sleeper.woken = false;", ""),
    ("not_parked", "if inner.park(topic)\n", "if false\n"),
    (
        "no_look_after_parking",
        "if inner.park(topic)\n",
        "if !inner.park(topic)\n",
    ),
    (
        "bell_not_rung",
        "        inner.sleepers.wake(topic);\n        Ok(bell)",
        "        Ok(bell)",
    ),
];

/// Faults of the words of a ring. `tests/ring.rs` expects each to be found.
const RING: &[Change] = &[
    ("no_fence", "    fence(Ordering::SeqCst);\n", ""),
    (
        "weak_fence",
        "fence(Ordering::SeqCst)",
        "fence(Ordering::AcqRel)",
    ),
    (
        "put_without_release",
        "word.swap(bits.to_le(), Ordering::AcqRel)",
        "word.swap(bits.to_le(), Ordering::Acquire)",
    ),
    (
        "load_without_acquire",
        "word.load(Ordering::Acquire)",
        "word.load(Ordering::Relaxed)",
    ),
    (
        "swap_without_acquire",
        "word.swap(bits.to_le(), Ordering::AcqRel)",
        "word.swap(bits.to_le(), Ordering::Release)",
    ),
    ("taken_anyway", "taken.is_ok()", "true"),
    (
        "taken_unseen",
        "word.compare_exchange(bits.to_le(), 0, Ordering::AcqRel, Ordering::Relaxed);",
        "Ok::<_, ()>(word.swap(0, Ordering::AcqRel));",
    ),
    (
        "put_in_two_steps",
        "    u64::from_le(word.swap(bits.to_le(), Ordering::AcqRel))",
        "    let was = word.load(Ordering::Acquire);\n    \
         word.store(bits.to_le(), Ordering::Release);\n    u64::from_le(was)",
    ),
];

/// Orderings of which one suffices in most executions: a change removes several together.
const RING_TOGETHER: &[Together] = &[
    (
        "taken_without_acquire",
        &[
            LOAD_RELAXED,
            (
                "bits.to_le(), 0, Ordering::AcqRel,",
                "bits.to_le(), 0, Ordering::Release,",
            ),
        ],
    ),
    (
        "back_without_acquire",
        &[
            LOAD_RELAXED,
            (
                "word.swap(bits.to_le(), Ordering::AcqRel)",
                "word.swap(bits.to_le(), Ordering::Release)",
            ),
        ],
    ),
];

const LOAD_RELAXED: (&str, &str) = (
    "word.load(Ordering::Acquire)",
    "word.load(Ordering::Relaxed)",
);

/// Replaces the kernel by the model's.
const KERNEL: &[(&str, &str)] = &[
    ("std::os::fd::", "crate::kernel::"),
    ("sm2_io::", "crate::kernel::"),
];

fn main() {
    variants(
        "counters",
        "sm2-io/src/counters/seqlock.rs",
        &[],
        SEQLOCK,
        &[],
    );
    variants("sleepers", "sm2-node/src/driver/wait.rs", KERNEL, WAIT, &[]);
    let atomic = "sm2-io/src/ring/atomic.rs";
    variants("ring", atomic, &[], RING, RING_TOGETHER);
}

/// Writes `$OUT_DIR/<test>.rs`. For the shipped source and for each change, it has a module with
/// that source and with `tests/<test>/scenarios.rs`, which tests it.
fn variants(
    test: &str,
    source: &str,
    renamed: &[(&str, &str)],
    changes: &[Change],
    together: &[Together],
) {
    let here = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("set by Cargo"));
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("set by Cargo"));
    let path = here.join("../..").join(source);
    println!("cargo::rerun-if-changed={}", path.display());
    let mut shipped = fs::read_to_string(&path).expect("the source is there");
    for (from, to) in renamed {
        assert!(
            shipped.contains(from),
            "{source} has no `{from}`: mend build.rs"
        );
        shipped = shipped.replace(from, to);
    }
    let scenarios = here.join("tests").join(test).join("scenarios.rs");
    let stem = path.file_stem().and_then(|it| it.to_str()).expect("a name");
    let mut modules = String::new();
    let mut add = |name: &str, text: &str| {
        let file = out.join(format!("{test}_{name}.rs"));
        fs::write(&file, text).expect("OUT_DIR is writable");
        module(&mut modules, name, stem, &file, &scenarios);
    };
    add("shipped", &shipped);
    let changed = |name: &str, text: &str, from: &str, to: &str| {
        let count = text.matches(from).count();
        assert_eq!(
            count, 1,
            "{source}, {name}: not once: `{from}`; mend build.rs"
        );
        text.replace(from, to)
    };
    for (name, from, to) in changes {
        add(name, &changed(name, &shipped, from, to));
    }
    for (name, changes) in together {
        let mut text = shipped.clone();
        for (from, to) in *changes {
            text = changed(name, &text, from, to);
        }
        add(name, &text);
    }
    fs::write(out.join(format!("{test}.rs")), modules).expect("OUT_DIR is writable");
}

fn module(modules: &mut String, name: &str, stem: &str, file: &Path, scenarios: &Path) {
    // A test does not use every item of the source, and a faulty variant uses even fewer.
    write!(
        modules,
        "#[allow(dead_code, unused)]\nmod {name} {{\n\
         #[path = {file:?}]\nmod {stem};\n\
         #[path = {scenarios:?}]\npub(crate) mod scenarios;\n\
         use scenarios::*;\n\
         }}\n"
    )
    .expect("a string takes all");
}
