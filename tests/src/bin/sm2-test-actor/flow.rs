//! `flow --prefix P --first N --count N --total N --hears 1,8 --rate HZ --size BYTES`: nodes
//! that exchange numbered messages without a pause, while Managers come and go.
//!
//! Node i is named `P/i`. It publishes topic `P/i` reliably at the given rate, and subscribes to
//! the topics of the nodes at the given distances. If a message is missing, doubled or out of
//! order, the process panics.
//!
//! First it declares everything, waits for all links and answers `linked`. Then it follows the
//! lines of standard input:
//!
//! - `go`: publishes; answers `flowing`.
//! - `stop`: publishes a last, empty message, and takes messages until it has the last one of each
//!   node that it subscribes to. Answers `done published=N received=N links=N`, with the number of
//!   all links that it ever had.

use std::{
    os::fd::AsFd,
    process::ExitCode,
    time::{Duration, Instant},
};

use sm2_node::{Node, Publisher, Sample, Subscriber};
use sm2_tests::{TIMEOUT, input::Input, options::Options};

/// How often all nodes are driven.
const TICK: Duration = Duration::from_millis(5);

struct Member {
    node: Node,
    publisher: Publisher<[u8]>,
    published: u64,
    heard: Vec<Heard>,
}

struct Heard {
    subscriber: Subscriber<[u8]>,
    received: u64,
    over: bool,
}

struct Plan {
    size: usize,
    /// `None`: nothing is published except the last message.
    period: Option<Duration>,
    /// The number of subscribers of each topic.
    hearers: usize,
}

pub(crate) fn run(options: &Options) -> ExitCode {
    let number = |name: &str| options.get::<usize>(name).expect("a number");
    let rate: u32 = options.get("--rate").expect("--rate");
    let hears: String = options.get_or("--hears", String::new());
    let distances = hears.split(',').filter(|word| !word.is_empty());
    let distances: Vec<usize> = distances
        .map(|word| word.parse().expect("a distance"))
        .collect();
    let plan = Plan {
        size: number("--size"),
        period: (rate > 0).then(|| Duration::from_secs(1) / rate),
        hearers: options.get_or("--hearers", distances.len()),
    };
    let all = number("--first")..number("--first") + number("--count");
    let mut members: Vec<Member> = all
        .map(|index| member(options, index, &distances))
        .collect();
    let mut input = Input::new();
    until(&mut members, &mut input, |member| member.is_linked(&plan));
    println!("linked");
    until_told(&mut members, &mut input, "go", None);
    println!("flowing");
    until_told(&mut members, &mut input, "stop", Some(&plan));
    for member in &mut members {
        let last = member.publisher.publish(&[]).expect("published");
        assert_eq!(last.missed, 0);
    }
    until(&mut members, &mut input, |member| {
        member.heard.iter().all(|heard| heard.over)
    });
    let published: u64 = members.iter().map(|member| member.published).sum();
    let heard = members.iter().flat_map(|member| &member.heard);
    let received: u64 = heard.map(|heard| heard.received).sum();
    let links: usize = members.iter().map(|it| it.publisher.links().len()).sum();
    println!("done published={published} received={received} links={links}");
    until_told(&mut members, &mut input, "end", None);
    ExitCode::SUCCESS
}

fn member(options: &Options, index: usize, distances: &[usize]) -> Member {
    let prefix: String = options.get("--prefix").expect("--prefix");
    let socket: String = options.get("--socket").expect("--socket");
    let total: usize = options.get("--total").expect("--total");
    let topic = |index: usize| format!("{prefix}/{index}");
    let node = Node::builder(&topic(index)).socket(socket);
    let node = node.manager_timeout(TIMEOUT).connect().expect("a session");
    let publisher = node.publisher_builder::<[u8]>(&topic(index)).depth(64);
    let publisher = publisher.reliable(true).publish_timeout(TIMEOUT).declare();
    let hear = |distance: &usize| {
        let topic = topic((index + distance) % total);
        let subscriber = node.subscriber_builder::<[u8]>(&topic).depth(64);
        Heard {
            subscriber: subscriber.reliable(true).declare().expect("a subscriber"),
            received: 0,
            over: false,
        }
    };
    let heard = distances.iter().map(hear).collect();
    Member {
        publisher: publisher.expect("a publisher"),
        published: 0,
        heard,
        node,
    }
}

impl Member {
    fn is_linked(&self, plan: &Plan) -> bool {
        let open = |links: Vec<sm2_node::diagnostics::LinkStatus>| {
            links.iter().filter(|it| it.open).count()
        };
        let heard = self.heard.iter();
        open(self.publisher.links()) == plan.hearers
            && heard.map(|it| open(it.subscriber.links())).all(|n| n == 1)
    }

    fn publish(&mut self, size: usize) {
        self.published += 1;
        let number = self.published.to_le_bytes();
        let mut message = self.publisher.loan_slice(size).expect("memory");
        message[..8].copy_from_slice(&number);
        message[size - 8..].copy_from_slice(&number);
        let result = message.publish().expect("published");
        assert_eq!(result.missed, 0, "{}: {result:?}", self.node.name());
    }

    fn take(&mut self) {
        self.node.spin_some().expect("the node's own wait");
        let name = self.node.name();
        for heard in &mut self.heard {
            while let Some(sample) = heard.subscriber.try_recv().expect("received") {
                heard.note(name.as_str(), &sample);
            }
        }
    }
}

impl Heard {
    fn note(&mut self, name: &str, sample: &Sample<[u8]>) {
        let from = sample.publisher();
        assert!(!self.over, "{name}: a message of {from} after its last one");
        assert_eq!(sample.lost(), 0, "{name}: lost from {from}");
        if sample.is_empty() {
            self.over = true;
            return;
        }
        self.received += 1;
        let number = self.received.to_le_bytes();
        let ends = (&sample[..8], &sample[sample.len() - 8..]);
        assert_eq!(ends, (&number[..], &number[..]), "{name}: from {from}");
    }
}

/// Drives all nodes until `done` is true of each.
fn until(members: &mut [Member], input: &mut Input, done: impl Fn(&Member) -> bool) {
    let end = Instant::now() + TIMEOUT;
    while !members.iter().all(&done) {
        turn(members, input, None, None);
        assert!(Instant::now() < end, "waited in vain");
    }
}

/// Drives all nodes, and publishes as planned, until the line `word` arrives.
fn until_told(members: &mut [Member], input: &mut Input, word: &str, plan: Option<&Plan>) {
    let mut due = Instant::now();
    while turn(members, input, plan, Some(&mut due)).is_none_or(|line| line != word) {}
}

/// Drives all nodes once. Returns the line that arrived, if there is one.
fn turn(
    members: &mut [Member],
    input: &mut Input,
    plan: Option<&Plan>,
    due: Option<&mut Instant>,
) -> Option<String> {
    if let (Some(plan), Some(due)) = (plan, due)
        && let Some(period) = plan.period
        && *due <= Instant::now()
    {
        // At most one period behind, however late this turn is.
        *due = (*due + period).max(Instant::now());
        members.iter_mut().for_each(|it| it.publish(plan.size));
    }
    members.iter_mut().for_each(Member::take);
    let Ok(lines) = input.lines() else {
        std::process::exit(0);
    };
    let line = lines.into_iter().next();
    if line.is_none() {
        sm2_io::wait_readable(&[input.as_fd()], Some(TICK)).expect("poll");
    }
    line
}
