//! The process of one gateway: a Manager, the gateway, and a node that publishes or subscribes.

use std::{
    fmt::Write as _,
    fs,
    io::{self, BufRead, Write as _},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use sm2_gateway::{Config, Gateway, keys};
use sm2_manager::{Background, Options};
use sm2_node::{Node, Publisher, Subscriber};
use tokio::runtime::Runtime;

use crate::{Done, network::hub_address};

const TOPIC: &str = "stream";

fn path(folder: &Path, number: usize, kind: &str) -> PathBuf {
    folder.join(format!("{number}.{kind}"))
}

/// Writes the keys and configurations of the hub, which is number 0, and of its peers.
pub(crate) fn configure(folder: &Path, peers: usize) -> Done {
    let ids: Result<Vec<_>, _> = (0..=peers)
        .map(|it| keys::generate(&path(folder, it, "key")).map(|it| it.id()))
        .collect();
    let ids = ids?;
    for number in 0..=peers {
        let mut text = format!(
            "name = \"g{number}\"\nlisten = \"0.0.0.0:7633\"\nkey = \"{number}.key\"\nsocket = \"{number}.sock\"\n\
             [[rule]]\naction = \"allow\"\nnames = \"**\"\n"
        );
        let known = if number == 0 { 1..=peers } else { 0..=0 };
        for peer in known {
            write!(
                text,
                "[[peer]]\nname = \"g{peer}\"\nid = \"{}\"\n",
                ids[peer]
            )?;
            if peer == 0 {
                writeln!(text, "addresses = [\"{}\"]", hub_address(number))?;
            }
        }
        fs::write(path(folder, number, "toml"), text)?;
    }
    Ok(())
}

/// The work of the node: a thread that publishes or subscribes.
struct Work {
    count: Arc<AtomicU64>,
    is_linked: Arc<AtomicBool>,
    is_over: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Work {
    fn start(work: impl FnOnce(&AtomicU64, &AtomicBool, &AtomicBool) + Send + 'static) -> Self {
        let (count, is_linked, is_over) = (Arc::default(), Arc::default(), Arc::default());
        let theirs = (
            Arc::clone(&count),
            Arc::clone(&is_linked),
            Arc::clone(&is_over),
        );
        let thread = thread::spawn(move || work(&theirs.0, &theirs.1, &theirs.2));
        Self {
            count,
            is_linked,
            is_over,
            thread,
        }
    }

    fn publish(node: &Node, len_bytes: usize, hz: u32) -> Done<Self> {
        let publisher: Publisher<[u8]> = node.publisher_builder(TOPIC).declare()?;
        Ok(Self::start(move |count, _, is_over| {
            let mut next = Instant::now();
            while !is_over.load(Ordering::Relaxed) {
                thread::sleep(next.saturating_duration_since(Instant::now()));
                let loan = publisher.loan_slice(len_bytes);
                if loan.is_ok_and(|it| it.publish().is_ok()) {
                    count.fetch_add(1, Ordering::Relaxed);
                }
                next += Duration::from_secs(1) / hz;
            }
        }))
    }

    fn subscribe(node: &Node, depth: u16) -> Done<Self> {
        let builder = node.subscriber_builder(TOPIC).depth(depth);
        let subscriber: Subscriber<[u8]> = builder.declare()?;
        Ok(Self::start(move |count, is_linked, is_over| {
            while !is_over.load(Ordering::Relaxed) {
                let taken = subscriber.recv_timeout(Duration::from_millis(100));
                if taken.is_ok_and(|it| it.is_some()) {
                    is_linked.store(true, Ordering::Relaxed);
                    count.fetch_add(1, Ordering::Relaxed);
                }
            }
        }))
    }

    fn end(self) {
        self.is_over.store(true, Ordering::Relaxed);
        // A panic of the thread was printed.
        let _ = self.thread.join();
    }
}

/// Runs a gateway, and obeys the lines of standard input until it ends.
pub(crate) fn serve(folder: &Path, number: usize) -> Done {
    let socket = path(folder, number, "sock");
    let _manager = Background::start(&socket, Options::default())?;
    let config = Config::load(&path(folder, number, "toml"))?;
    let runtime = Runtime::new()?;
    let gateway = runtime.block_on(Gateway::start(&config))?;
    let node = Node::builder("node").socket(&socket).connect()?;
    let mut work: Option<Work> = None;
    for line in io::stdin().lock().lines() {
        let line = line?;
        let words: Vec<&str> = line.split(' ').collect();
        let mut answer = "done".to_owned();
        match words[..] {
            ["ready"] => {}
            ["publish", len_bytes, hz] => {
                work = Some(Work::publish(&node, len_bytes.parse()?, hz.parse()?)?);
            }
            ["subscribe", depth] => work = Some(Work::subscribe(&node, depth.parse()?)?),
            ["stop" | "unsubscribe"] => work.take().into_iter().for_each(Work::end),
            ["count"] => {
                let count = work.as_ref().map(|it| it.count.load(Ordering::Relaxed));
                answer = count.unwrap_or(0).to_string();
            }
            ["linked"] => {
                let is_linked = work.as_ref().map(|it| it.is_linked.load(Ordering::Relaxed));
                answer = is_linked.unwrap_or(false).to_string();
            }
            ["connected"] => {
                let report = runtime.block_on(gateway.report());
                answer = report.is_some_and(|it| !it.peers.is_empty()).to_string();
            }
            _ => return Err(format!("unknown: {line}").into()),
        }
        println!("{answer}");
        io::stdout().flush()?;
    }
    Ok(())
}
