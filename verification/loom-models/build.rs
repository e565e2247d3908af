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
        "            let waker = locked.sleepers.enter()?;\n            \
         let short_of_memory = locked.short_of_memory;\n            drop(locked);\n",
        "            let short_of_memory = locked.short_of_memory;\n            drop(locked);\n            \
         let waker = self.lock().sleepers.enter()?;\n",
    ),
    (
        "entered_late_for_the_session",
        "            let waker = control.sleepers.enter()?;\n            \
         let short_of_memory = control.short_of_memory;\n            drop(control);\n",
        "            let short_of_memory = control.short_of_memory;\n            drop(control);\n            \
         let waker = self.lock().sleepers.enter()?;\n",
    ),
    (
        "no_sockets",
        "let sets = if short_of_memory { &[] } else { sets };",
        "let sets = &sets[..0];",
    ),
    ("woken_for_ever", "sleeper.state = State::Asleep;", ""),
    ("not_parked", "            locked.park();\n", ""),
    (
        "no_look_after_parking",
        "            locked.park();\n            if let Some(found) = look(&mut locked) {\n                \
         return Ok(Some(found));\n            }\n",
        "            locked.park();\n",
    ),
    (
        "bell_not_rung",
        "        locked.sleepers.wake();\n        Ok(bell)",
        "        Ok(bell)",
    ),
    (
        "set_not_parked",
        "        locked.park();\n        locked.change(&mut look);\n",
        "        locked.change(&mut look);\n",
    ),
    (
        "no_look_after_parking_in_a_set",
        "        locked.park();\n        locked.change(&mut look);\n",
        "        locked.park();\n",
    ),
];

/// Faults of a value that is used again. `tests/reusable.rs` expects each to be found.
const REUSABLE: &[Change] = &[
    (
        "lent_without_acquire",
        "holders.load(Ordering::Acquire)",
        "holders.load(Ordering::Relaxed)",
    ),
    (
        "returned_without_release",
        "fetch_sub(1, Ordering::Release)",
        "fetch_sub(1, Ordering::Relaxed)",
    ),
    (
        "lent_twice",
        "if shared.holders.load(Ordering::Acquire) != 1 {",
        "if false {",
    ),
    (
        "freed_without_acquire",
        "            fence(Ordering::Acquire);\n",
        "",
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
    (
        "taken_without_release",
        "bits.to_le(), 0, Ordering::AcqRel,",
        "bits.to_le(), 0, Ordering::Acquire,",
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

/// Orderings where one suffices in most executions: a change removes several together.
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
        &["sm2-io/src/counters/seqlock.rs"],
        &[],
        SEQLOCK,
        &[],
    );
    variants("reusable", &["sm2-io/src/reusable.rs"], &[], REUSABLE, &[]);
    let waiting = ["sleepers", "sleep", "wait", "bell", "watch"]
        .map(|it| format!("sm2-node/src/driver/{it}.rs"));
    let waiting = waiting.each_ref().map(String::as_str);
    variants("sleepers", &waiting, KERNEL, WAIT, &[]);
    let atomic = ["sm2-io/src/ring/atomic.rs"];
    variants("ring", &atomic, &[], RING, RING_TOGETHER);
}

/// A shipped source: the name of its module, and its text.
#[derive(Clone)]
struct Source {
    module: String,
    text: String,
}

/// Writes `$OUT_DIR/<test>.rs`. For the shipped sources and for each change, it has a module with
/// these sources and with `tests/<test>/scenarios.rs`, which tests them.
fn variants(
    test: &str,
    paths: &[&str],
    renamed: &[(&str, &str)],
    changes: &[Change],
    together: &[Together],
) {
    let here = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("set by Cargo"));
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("set by Cargo"));
    let mut shipped: Vec<Source> = Vec::new();
    for path in paths {
        let path = here.join("../..").join(path);
        println!("cargo::rerun-if-changed={}", path.display());
        let stem = path.file_stem().and_then(|it| it.to_str()).expect("a name");
        shipped.push(Source {
            module: stem.to_owned(),
            text: fs::read_to_string(&path).expect("the source is there"),
        });
    }
    for (from, to) in renamed {
        assert!(
            shipped.iter().any(|it| it.text.contains(from)),
            "{test}: no source has `{from}`: mend build.rs"
        );
        for source in &mut shipped {
            source.text = source.text.replace(from, to);
        }
    }
    let scenarios = here.join("tests").join(test).join("scenarios.rs");
    let mut modules = String::new();
    let mut add = |name: &str, sources: &[Source]| {
        let mut files = Vec::new();
        for Source { module, text } in sources {
            let file = out.join(format!("{test}_{name}_{module}.rs"));
            fs::write(&file, text).expect("OUT_DIR is writable");
            files.push((module.as_str(), file));
        }
        write_module(&mut modules, name, &files, &scenarios);
    };
    add("shipped", &shipped);
    for change in changes {
        let mut sources = shipped.clone();
        make(&mut sources, test, change);
        add(change.0, &sources);
    }
    for (name, changes) in together {
        let mut sources = shipped.clone();
        for (from, to) in *changes {
            make(&mut sources, test, &(name, from, to));
        }
        add(name, &sources);
    }
    fs::write(out.join(format!("{test}.rs")), modules).expect("OUT_DIR is writable");
}

/// Makes a change in the only place of all sources that has its text.
fn make(sources: &mut [Source], test: &str, &(name, from, to): &Change) {
    let count: usize = sources.iter().map(|it| it.text.matches(from).count()).sum();
    assert_eq!(
        count, 1,
        "{test}, {name}: not once: `{from}`; mend build.rs"
    );
    for source in sources {
        source.text = source.text.replace(from, to);
    }
}

fn write_module(modules: &mut String, name: &str, files: &[(&str, PathBuf)], scenarios: &Path) {
    // A test does not use every item of the sources, and a faulty variant uses even fewer.
    let mut text = format!("#[allow(dead_code, unused)]\nmod {name} {{\n");
    for (module, file) in files {
        writeln!(text, "#[path = {file:?}]\nmod {module};").expect("a string takes all");
    }
    write!(
        text,
        "#[path = {scenarios:?}]\npub(crate) mod scenarios;\n\
         use scenarios::*;\n\
         }}\n"
    )
    .expect("a string takes all");
    modules.push_str(&text);
}
