//! Measures a publisher and its healthy subscriber while other subscribers die, and prints a table in Markdown.
//!
//! Usage: `deaths [--repeats N] [--only WORD]`
//!
//! A publisher sends messages at 200 Hz. Each row has figures of windows of one second: those of the windows without a
//! death, then those of the windows when the others are killed. A gap is the longest time between two messages that
//! the healthy subscriber takes; a publish is the longest call. Nothing is asserted about times. Exit status: 1 if a
//! message was damaged, or if the healthy subscriber got none.

use std::{
    path::Path,
    process::ExitCode,
    thread,
    time::{Duration, Instant},
};

use nix::sys::signal::Signal;
use sm2_node::{Node, Publisher, Sample, Subscriber};
use sm2_tests::{
    TIMEOUT,
    actor::number,
    domain::TempDomain,
    input::{Input, abort_at_end},
    options::Options,
    pattern,
    process::{Process, this_program},
};

const TOPIC: &str = "deaths";
const PERIOD: Duration = Duration::from_millis(5);
const WINDOW: Duration = Duration::from_secs(1);
/// Enough for all messages that the dying subscribers hold.
const POOL_LIMIT_BYTES: u64 = 1 << 30;

/// The subscribers that die.
struct Case {
    name: &'static str,
    /// The length of each message, in bytes.
    message_bytes: usize,
    /// How many messages each process holds, and how many subscribers it has.
    dying: &'static [(usize, usize)],
}

const CASES: &[Case] = &[
    Case {
        name: "two subscribers that hold 128 and 64 messages of 1 MB",
        message_bytes: 1_000_000,
        dying: &[(128, 1), (64, 1)],
    },
    Case {
        name: "200 subscribers that do not read 10 kB",
        message_bytes: 10_000,
        dying: &[(0, 200)],
    },
];

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1).peekable();
    // The processes of the run are started from this program, with a role.
    if let Some(role) = arguments.next_if(|it| !it.starts_with('-')) {
        let options = Options::parse(arguments);
        match role.as_str() {
            "manager" => return sm2_tests::manager::run(&options),
            "publisher" => publish(&options),
            "healthy" => subscribe(&options),
            "dying" => hold(&options),
            other => panic!("no role {other:?}"),
        }
        return ExitCode::SUCCESS;
    }
    let options = Options::parse(arguments);
    let repeats = options.get_or("--repeats", 3);
    let only: String = options.get_or("--only", String::new());
    println!(
        "| what dies | longest gap, ms | longest publish, ms | lost |\n| --- | --- | --- | --- |"
    );
    let mut is_good = true;
    for case in CASES.iter().filter(|it| it.name.contains(&only)) {
        is_good &= measure(case, repeats);
    }
    match is_good {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    }
}

/// Prints the row of a case. Returns whether all messages were intact, and some came.
fn measure(case: &Case, repeats: usize) -> bool {
    let (mut without, mut with) = (Vec::new(), Vec::new());
    for _ in 0..repeats {
        let domain = TempDomain::new();
        let socket = domain.socket();
        let manager = start("manager", &socket, &[]);
        manager.stderr_says("serving");
        let bytes = case.message_bytes.to_string();
        let publisher = start("publisher", &socket, &["--bytes", &bytes]);
        let healthy = start("healthy", &socket, &[]);
        let dying = case.dying.iter().enumerate();
        let dying = dying.map(|(index, (held, subscribers))| {
            let [index, held, subscribers] = [index, *held, *subscribers].map(|it| it.to_string());
            let options = [("--number", index), ("--held", held)];
            let options = options.iter().flat_map(|(name, value)| [*name, value]);
            let options: Vec<&str> = options.chain(["--subscribers", &subscribers]).collect();
            start("dying", &socket, &options)
        });
        let mut dying: Vec<Process> = dying.collect();
        for process in dying.iter().chain([&publisher, &healthy]) {
            assert_eq!(process.expect_line(), "ready");
        }
        let mut measured = [publisher, healthy];
        without.push(window(&mut measured, || {}));
        with.push(window(&mut measured, || {
            for process in &mut dying {
                process.signal(Signal::SIGKILL);
            }
        }));
    }
    let cell = |of: fn(&Figures) -> u64| {
        let text = |all: &[Figures]| {
            let values: Vec<String> = all.iter().map(|it| of(it).to_string()).collect();
            values.join(", ")
        };
        format!("{} → {}", text(&without), text(&with))
    };
    let (gap, publish, lost) = (
        cell(|it| it.gap_us / 1_000),
        cell(|it| it.publish_us / 1_000),
        cell(|it| it.lost),
    );
    println!("| {} | {gap} | {publish} | {lost} |", case.name);
    (without.iter().chain(&with)).all(|it| it.taken > 0 && it.damaged == 0)
}

/// The figures of a window.
struct Figures {
    gap_us: u64,
    publish_us: u64,
    lost: u64,
    taken: u64,
    damaged: u64,
}

/// Measures a window when this happens.
fn window([publisher, healthy]: &mut [Process; 2], event: impl FnOnce()) -> Figures {
    publisher.say("begin");
    healthy.say("begin");
    thread::sleep(WINDOW / 4);
    event();
    thread::sleep(WINDOW / 4 * 3);
    publisher.say("end");
    healthy.say("end");
    let (publisher, healthy) = (publisher.expect_line(), healthy.expect_line());
    Figures {
        gap_us: number(&healthy, "gap_us"),
        publish_us: number(&publisher, "publish_us"),
        lost: number(&healthy, "lost"),
        taken: number(&healthy, "taken"),
        damaged: number(&healthy, "damaged"),
    }
}

/// Starts this program in a role.
fn start(role: &str, socket: &Path, options: &[&str]) -> Process {
    let mut command = this_program(role);
    command.arg("--socket").arg(socket).args(options);
    Process::start(command)
}

fn node(name: &str, options: &Options) -> Node {
    let socket: String = options.get("--socket").expect("--socket");
    let node = Node::builder(name).socket(socket).manager_timeout(TIMEOUT);
    node.connect().expect("a session")
}

fn publish(options: &Options) {
    let node = node("publisher", options);
    let builder = node.publisher_builder::<[u8]>(TOPIC);
    let publisher = builder.pool_limit(POOL_LIMIT_BYTES).declare();
    let publisher: Publisher<[u8]> = publisher.expect("a publisher");
    let bytes = options.get("--bytes").expect("--bytes");
    let mut input = Input::new();
    println!("ready");
    let (mut due, mut longest) = (Instant::now(), Duration::ZERO);
    for number in 1.. {
        thread::sleep(due.saturating_duration_since(Instant::now()));
        due = (due + PERIOD).max(Instant::now());
        let Ok(lines) = input.lines() else {
            return;
        };
        if lines.iter().any(|it| it == "end") {
            println!("publish_us={}", longest.as_micros());
        }
        if !lines.is_empty() {
            longest = Duration::ZERO;
        }
        let begin = Instant::now();
        if let Ok(mut message) = publisher.loan_slice(bytes) {
            pattern::fill(&mut message, number);
            let _ = message.publish();
        }
        longest = longest.max(begin.elapsed());
    }
}

fn subscribe(options: &Options) {
    let node = node("healthy", options);
    let subscriber: Subscriber<[u8]> = node.subscriber(TOPIC).expect("a subscriber");
    let mut input = Input::new();
    subscriber.recv_timeout(TIMEOUT).expect("received");
    println!("ready");
    let (mut gap, mut last) = (Duration::ZERO, Instant::now());
    let (mut lost, mut taken, mut damaged) = (0, 0, 0);
    while let Ok(lines) = input.lines() {
        if let Ok(Some(sample)) = subscriber.recv_timeout(Duration::from_millis(10)) {
            gap = gap.max(last.elapsed());
            last = Instant::now();
            lost += sample.lost();
            taken += 1;
            damaged += u64::from(!pattern::is_intact(&sample, sample.sequence()));
        }
        if lines.iter().any(|it| it == "end") {
            let gap_us = gap.max(last.elapsed()).as_micros();
            println!("gap_us={gap_us} lost={lost} taken={taken} damaged={damaged}");
        }
        if !lines.is_empty() {
            (gap, last) = (Duration::ZERO, Instant::now());
            (lost, taken, damaged) = (0, 0, 0);
        }
    }
}

fn hold(options: &Options) {
    abort_at_end();
    let number: usize = options.get_or("--number", 0);
    let node = node(&format!("dying/{number}"), options);
    let held = options.get_or("--held", 0);
    let subscribers = 0..options.get_or("--subscribers", 1);
    let subscribers = subscribers.map(|_| {
        let builder = node.subscriber_builder::<[u8]>(TOPIC);
        builder.max_borrowed(held.max(1)).declare()
    });
    let subscribers: Result<Vec<Subscriber<[u8]>>, _> = subscribers.collect();
    let subscribers = subscribers.expect("subscribers");
    for subscriber in &subscribers {
        let linked = subscriber.wait_for_publishers_timeout(1, TIMEOUT);
        linked.expect("a publisher");
    }
    let mut samples: Vec<Sample<[u8]>> = Vec::new();
    while samples.len() < usize::from(held) {
        samples.extend(subscribers[0].recv_timeout(TIMEOUT).expect("received"));
    }
    println!("ready");
    loop {
        thread::park();
    }
}
