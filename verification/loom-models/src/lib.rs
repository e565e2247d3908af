//! Runs models through loom, and reports the coverage.

use std::env;
use std::fs::OpenOptions;
use std::io::Write as _;
use std::panic;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::Instant;

/// The variable that names the file where each model appends a line, in the format of
/// `verification/check`.
const RESULTS: &str = "SM2_VERIFICATION_RESULTS";

/// The expected number of executions of each model.
const COUNTS: &str = include_str!("../counts.txt");

/// Runs a model through all executions with at most `preemptions` preemptions (`None`: no limit),
/// and prints a line. Panics if an execution fails.
pub fn holds(name: &str, preemptions: Option<usize>, model: fn()) {
    let told = Told::new(name);
    explore(preemptions, model, &told.executions);
    told.holds(preemptions);
}

/// Like [`holds`], for a model where one side stops after 0 steps, after 1, and so on. The model
/// returns whether that side stopped early. The runs end when it stopped early in no execution.
pub fn holds_at_each_step(
    name: &str,
    preemptions: Option<usize>,
    model: impl Fn(u32) -> bool + Copy + Send + Sync + 'static,
) {
    let told = Told::new(name);
    let stopped = Arc::new(AtomicBool::new(true));
    for steps in 0.. {
        if !stopped.swap(false, Ordering::Relaxed) {
            break;
        }
        let stopped = Arc::clone(&stopped);
        let model = move || {
            stopped.fetch_or(model(steps), Ordering::Relaxed);
        };
        explore(preemptions, model, &told.executions);
    }
    told.holds(preemptions);
}

/// Appends the result of a model when it is dropped. During a panic, the result is a failure.
struct Told<'a> {
    name: &'a str,
    start: Instant,
    executions: Arc<AtomicU64>,
}

impl<'a> Told<'a> {
    fn new(name: &'a str) -> Self {
        Self {
            name,
            start: Instant::now(),
            executions: Arc::default(),
        }
    }

    fn holds(self, preemptions: Option<usize>) {
        let name = self.name;
        let executions = self.executions.load(Ordering::Relaxed);
        let bound = preemptions.map_or("unbounded".to_owned(), |it| format!("preemptions <= {it}"));
        let time_s = self.start.elapsed().as_secs_f64();
        println!("holds    {name:<36} {executions:>8} executions  {time_s:>6.2} s  {bound}");
        assert!(executions > 1, "nothing happened at once in {name}");
        assert_expected(name, executions);
    }
}

impl Drop for Told<'_> {
    fn drop(&mut self) {
        let Some(file) = env::var_os(RESULTS) else {
            return;
        };
        let verdict = if thread::panicking() { "FAILED" } else { "ok" };
        let time_s = self.start.elapsed().as_secs_f64();
        let executions = self.executions.load(Ordering::Relaxed);
        let name = self.name;
        let line = format!("loom\t{name}\t{verdict}\t{time_s:.1}\t{executions} executions\n");
        let file = OpenOptions::new().create(true).append(true).open(file);
        if let Err(error) = file.and_then(|mut it| it.write_all(line.as_bytes())) {
            // A panic during another panic would hide both.
            eprintln!("{RESULTS}: {error}");
        }
    }
}

/// The variable that names the faulty model that a child process runs.
const BROKEN: &str = "SM2_LOOM_BROKEN";

/// Runs a faulty model until an execution fails, and prints a line. For the test
/// `each_part_of_it_is_needed`, which it runs in a child process, since a failure that loom finds
/// in the middle of an execution may abort.
///
/// # Panics
///
/// If no execution fails, or the message of the first failure does not contain `because`.
pub fn fails(name: &str, preemptions: Option<usize>, because: &str, model: fn()) {
    if let Ok(broken) = env::var(BROKEN) {
        if broken == name {
            let executions = Arc::new(AtomicU64::new(0));
            let counted = Arc::clone(&executions);
            panic::set_hook(Box::new(move |info| {
                eprintln!("{} executions: {info}", counted.load(Ordering::Relaxed));
            }));
            explore(preemptions, model, &executions);
        }
        return;
    }
    let told = Told::new(name);
    let output = Command::new(env::current_exe().expect("a program"))
        .args(["--exact", "each_part_of_it_is_needed", "--nocapture"])
        .env(BROKEN, name)
        // The stack of a loom thread is too small to print a backtrace.
        .env("RUST_BACKTRACE", "0")
        .output()
        .expect("it starts");
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success(), "{name}: no execution shows it");
    assert!(text.contains(because), "{name}: failed otherwise: {text}");
    let executions = text.split(" executions:").next().unwrap_or_default();
    let executions: u64 = executions.trim().parse().expect("the hook counts them");
    told.executions.store(executions, Ordering::Relaxed);
    println!("refuted  {name:<36} {executions:>8} executions  {because}");
    assert_expected(name, executions);
}

/// Panics unless a model had as many executions as expected: with fewer ones it covers less.
fn assert_expected(name: &str, executions: u64) {
    let line = format!("{executions} {name}");
    let is_expected = COUNTS.lines().any(|it| it == line);
    assert!(is_expected, "counts.txt does not have: {line}");
}

fn explore(
    preemptions: Option<usize>,
    model: impl Fn() + Send + Sync + 'static,
    executions: &Arc<AtomicU64>,
) {
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = preemptions;
    builder.max_branches = 10_000;
    let executions = Arc::clone(executions);
    builder.check(move || {
        executions.fetch_add(1, Ordering::Relaxed);
        model();
    });
}
