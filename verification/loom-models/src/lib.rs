//! Running a model through loom, and saying how far that went.

use std::env;
use std::panic;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Runs a model through all executions with at most so many preemptions (`None`: all there are),
/// prints a line, and panics as the first execution does that fails.
pub fn holds(name: &str, preemptions: Option<usize>, model: fn()) {
    let start = Instant::now();
    let executions = Arc::new(AtomicU64::new(0));
    explore(preemptions, model, &executions);
    let executions = executions.load(Ordering::Relaxed);
    let bound = preemptions.map_or("unbounded".to_owned(), |it| format!("preemptions <= {it}"));
    let time_s = start.elapsed().as_secs_f64();
    println!("holds    {name:<34} {executions:>8} executions  {time_s:>6.2} s  {bound}");
    assert!(executions > 1, "nothing happened at once in {name}");
}

/// Names the broken model that a child process runs.
const BROKEN: &str = "SM2_LOOM_BROKEN";

/// Runs a model that is broken until an execution fails, and prints a line. For the test
/// `each_part_of_it_is_needed`, of which it starts a process: what loom finds in the
/// middle of an execution may abort.
///
/// # Panics
///
/// If none fails, or the first that does says something without `because` in it.
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
    let output = Command::new(env::current_exe().expect("a program"))
        .args(["--exact", "each_part_of_it_is_needed", "--nocapture"])
        .env(BROKEN, name)
        .output()
        .expect("it starts");
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success(), "{name}: no execution shows it");
    assert!(text.contains(because), "{name}: failed otherwise: {text}");
    let executions = text.split(" executions:").next().unwrap_or_default();
    println!("refuted  {name:<34} {executions:>8} executions  {because}");
}

fn explore(preemptions: Option<usize>, model: fn(), executions: &Arc<AtomicU64>) {
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = preemptions;
    builder.max_branches = 10_000;
    let executions = Arc::clone(executions);
    builder.check(move || {
        executions.fetch_add(1, Ordering::Relaxed);
        model();
    });
}
