//! Measures the cost of `sm2 topic hz` for the publisher that it measures.
//!
//! A process publishes 64 bytes at 1 kHz to another one. Its processor time is measured in turns: for some
//! seconds alone, and for some with `sm2 topic hz` running. The output has the medians and their ratio.
//!
//! ```text
//! cargo build --release -p sm2-cli
//! cargo run --release -p sm2-cli --example hz_cost -- [ROUNDS] [SECONDS]
//! ```

use std::{
    env,
    error::Error,
    fs,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use sm2_manager::{Background, Options};
use sm2_node::Node;

const TOPIC: &str = "load";

/// The time between two messages.
const PERIOD: Duration = Duration::from_millis(1);

/// The time for starting processes, which is not measured.
const SETTLING: Duration = Duration::from_millis(500);

type Done<T = ()> = Result<T, Box<dyn Error>>;

fn main() -> Done {
    let arguments: Vec<_> = env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["--publish", socket] => publish(socket),
        ["--subscribe", socket] => subscribe(socket),
        ref numbers => {
            let number = |at: usize, default| match numbers.get(at) {
                Some(text) => text.parse::<u32>(),
                None => Ok(default),
            };
            compare(number(0, 9)?, Duration::from_secs(number(1, 2)?.into()))
        }
    }
}

fn publish(socket: &str) -> Done {
    let node = Node::builder("publisher").socket(socket).connect()?;
    let publisher = node.publisher::<[u8]>(TOPIC)?;
    let start = Instant::now();
    for number in 0.. {
        let due = start + PERIOD * number;
        thread::sleep(due.saturating_duration_since(Instant::now()));
        publisher.publish(&[0; 64])?;
    }
    Ok(())
}

fn subscribe(socket: &str) -> Done {
    let node = Node::builder("subscriber").socket(socket).connect()?;
    let subscriber = node.subscriber::<[u8]>(TOPIC)?;
    loop {
        subscriber.recv()?;
    }
}

/// A process that is killed when this value is dropped.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn compare(rounds: u32, length: Duration) -> Done {
    let folder = tempfile::tempdir()?;
    let socket = folder.path().join("sm2.sock");
    let _manager = Background::start(&socket, Options::default())?;
    let itself = env::current_exe()?;
    let part = |role: &str| start(Command::new(&itself).arg(role).arg(&socket));
    let _subscriber = part("--subscribe")?;
    let publisher = part("--publish")?;
    let program = program()?;
    let hz = || {
        let mut command = Command::new(&program);
        start(
            command
                .args(["topic", "hz", TOPIC, "--socket"])
                .arg(&socket),
        )
    };
    let pid = publisher.0.id();
    let (mut alone, mut looked_at) = (Vec::new(), Vec::new());
    for _ in 0..rounds {
        alone.push(busy(pid, length)?);
        let _hz = hz()?;
        looked_at.push(busy(pid, length)?);
    }
    let (alone, looked_at) = (median(alone), median(looked_at));
    println!(
        "publisher of 1 kHz, medians of {rounds} turns of {} s each:",
        length.as_secs()
    );
    println!("  alone                   {alone:.3} % of a processor");
    println!("  with `sm2 topic hz`     {looked_at:.3} % of a processor");
    println!("  ratio                   {:.3}", looked_at / alone);
    Ok(())
}

fn start(command: &mut Command) -> Done<Running> {
    let child = command.stdin(Stdio::null()).stdout(Stdio::null()).spawn()?;
    Ok(Running(child))
}

/// The path of the command: the parent folder of the examples.
fn program() -> Done<PathBuf> {
    let itself = env::current_exe()?;
    let folder = itself.parent().and_then(Path::parent);
    let program = folder.ok_or("no folder of programs")?.join("sm2");
    match program.exists() {
        true => Ok(program),
        false => Err("build the command first: cargo build --release -p sm2-cli".into()),
    }
}

/// The load of a process during the next time span, in percent of a processor.
fn busy(pid: u32, length: Duration) -> Done<f64> {
    thread::sleep(SETTLING);
    let (before, start) = (run_time(pid)?, Instant::now());
    thread::sleep(length);
    let used = run_time(pid)? - before;
    Ok(100.0 * used.as_secs_f64() / start.elapsed().as_secs_f64())
}

/// The processor time of all threads of a process.
fn run_time(pid: u32) -> Done<Duration> {
    let mut sum = Duration::ZERO;
    for task in fs::read_dir(format!("/proc/{pid}/task"))? {
        let text = fs::read_to_string(task?.path().join("schedstat"))?;
        let nanos = text.split(' ').next().ok_or("an empty schedstat")?;
        sum += Duration::from_nanos(nanos.parse()?);
    }
    Ok(sum)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values[values.len() / 2]
}
