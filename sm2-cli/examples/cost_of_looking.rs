//! Measures what `sm2 topic hz` and `sm2 view` cost.
//!
//! A process publishes 64 bytes at 1 kHz to another one, in a domain with 50 further nodes. Each of these publishes
//! 64 bytes at 10 Hz to its neighbour. The processor time of the publisher is measured in turns: for some seconds
//! alone, for some with `sm2 topic hz`, and for some with `sm2 view` and a client that reads all that the page shows.
//! The output has the medians, and the processor time of `sm2 view`.
//!
//! ```text
//! cargo build --release -p sm2-cli
//! cargo run --release -p sm2-cli --example cost_of_looking -- [ROUNDS] [SECONDS]
//! ```

use std::{
    env,
    error::Error,
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use sm2_manager::{Background, Options};
use sm2_node::{Node, Rate};

const TOPIC: &str = "load";

/// How many further nodes the domain has.
const OTHERS: usize = 50;

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
        ["--others", socket] => others(socket),
        ["--read", url] => read(url),
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

/// The other nodes of the domain.
fn others(socket: &str) -> Done {
    let (mut publishers, mut subscribers) = (Vec::new(), Vec::new());
    for number in 0..OTHERS {
        let node = Node::builder(&format!("node{number}"))
            .socket(socket)
            .connect()?;
        publishers.push(node.publisher::<[u8]>(&format!("topic{number}"))?);
        let neighbour = format!("topic{}", (number + 1) % OTHERS);
        subscribers.push(node.subscriber::<[u8]>(&neighbour)?);
    }
    let mut pace = Rate::hz(10);
    loop {
        for publisher in &publishers {
            publisher.publish(&[0; 64])?;
        }
        for subscriber in &subscribers {
            while subscriber.try_recv()?.is_some() {}
        }
        pace.sleep();
    }
}

/// Reads the events of a page, as a browser does.
fn read(url: &str) -> Done {
    let (address, path) = (url.strip_prefix("http://"))
        .and_then(|it| it.split_once('/'))
        .ok_or("not a URL")?;
    let mut stream = TcpStream::connect(address)?;
    let path = path.trim_end_matches('/');
    write!(
        stream,
        "GET /{path}/api/events HTTP/1.1\r\nHost: {address}\r\n\r\n"
    )?;
    let mut bytes = [0; 1 << 16];
    while stream.read(&mut bytes)? > 0 {}
    Err("the page has ended".into())
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
    let command = |arguments: &[&str]| {
        let mut command = Command::new(&program);
        command.args(arguments).arg("--socket").arg(&socket);
        command
    };
    let _others = part("--others")?;
    let pid = publisher.0.id();
    let (mut alone, mut by_hz, mut by_view, mut view_itself) = (vec![], vec![], vec![], vec![]);
    for _ in 0..rounds {
        alone.push(busy([pid], length)?[0]);
        let hz = start(&mut command(&["topic", "hz", TOPIC]))?;
        by_hz.push(busy([pid], length)?[0]);
        drop(hz);
        let (view, url) = start_view(command(&["view"]))?;
        let _client = start(Command::new(&itself).args(["--read", &url]))?;
        let [of_publisher, of_view] = busy([pid, view.0.id()], length)?;
        by_view.push(of_publisher);
        view_itself.push(of_view);
    }
    let seconds = length.as_secs();
    println!(
        "medians (least to most) of {rounds} turns of {seconds} s each, in percent of a processor:"
    );
    println!("  publisher of 1 kHz alone    {}", spread(&mut alone));
    for (name, with) in [("hz", &mut by_hz), ("view", &mut by_view)] {
        println!("    with {name:4}                 {}", spread(with));
    }
    println!(
        "  view of {} nodes            {}",
        OTHERS + 2,
        spread(&mut view_itself)
    );
    Ok(())
}

fn start(command: &mut Command) -> Done<Running> {
    let child = command.stdin(Stdio::null()).stdout(Stdio::null()).spawn()?;
    Ok(Running(child))
}

/// Starts the server of the page. Returns its first line, the URL.
fn start_view(mut command: Command) -> Done<(Running, String)> {
    let mut view = Running(
        command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()?,
    );
    let mut line = String::new();
    let output = view.0.stdout.take().ok_or("no output")?;
    BufReader::new(output).read_line(&mut line)?;
    Ok((view, line.trim_end().to_owned()))
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

/// The load of processes during the next time span, in percent of a processor.
fn busy<const COUNT: usize>(pids: [u32; COUNT], length: Duration) -> Done<[f64; COUNT]> {
    thread::sleep(SETTLING);
    let start = Instant::now();
    let mut before = [Duration::ZERO; COUNT];
    for (before, pid) in before.iter_mut().zip(pids) {
        *before = run_time(pid)?;
    }
    thread::sleep(length);
    let mut loads = [0.0; COUNT];
    for ((load, before), pid) in loads.iter_mut().zip(before).zip(pids) {
        let used = run_time(pid)? - before;
        *load = 100.0 * used.as_secs_f64() / start.elapsed().as_secs_f64();
    }
    Ok(loads)
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

fn spread(values: &mut [f64]) -> String {
    values.sort_unstable_by(f64::total_cmp);
    let (least, median, most) = (
        values[0],
        values[values.len() / 2],
        values[values.len() - 1],
    );
    format!("{median:.3} ({least:.3} to {most:.3})")
}
