//! Robots and a site, each with its own domain and bridge, and two routers. One of these is killed. All bridges and
//! routers are processes.

use std::env;
use std::io::{self, Read as _};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use fastrand::Rng;
use sm2_node::{Publisher, Subscriber};
use sm2_test_support::{SOON, seed, until};

use crate::common::{Domain, free_endpoint, is_linked, router};
use crate::program::Program;

/// With the bridge of the site, there are ten bridges in the slow form.
const ROBOTS: usize = if cfg!(feature = "slow") { 9 } else { 3 };
/// How long each of the three phases of the test lasts at least. Fewer messages than `DEPTH` are published in one.
const PHASE: Duration = Duration::from_secs(if cfg!(feature = "slow") { 40 } else { 1 });
/// The pause between two steps.
const PAUSE: Duration = Duration::from_millis(100);
/// How many messages wait for the program at the site.
const DEPTH: u16 = 1_024;
const PAYLOAD_MAX: usize = 2_000;

const OUT: &str = "[spool]\nfolder = \"spool\"\n[[rule]]\naction = \"allow\"\nnames = \"robot/**\"\n\
    direction = \"out\"\ndurable = true\n";
const IN: &str = "[[rule]]\naction = \"allow\"\nnames = \"robot/**\"\ndirection = \"in\"\n";

/// The endpoint where the process of a router listens, and that of the router that it connects to.
const LISTEN: &str = "SM2_TEST_ROUTER";
const CONNECT: &str = "SM2_TEST_OTHER_ROUTER";

/// No test: a process of another test, which runs until its standard input ends.
#[test]
fn process_of_a_router() {
    if let Ok(endpoint) = env::var(LISTEN) {
        let _session = router(&endpoint, env::var(CONNECT).ok().as_deref());
        let _ = io::stdin().read(&mut [0]);
    }
}

/// A router in a process.
struct Router {
    endpoint: String,
    other: Option<String>,
    process: Child,
}

impl Router {
    fn start(endpoint: String, other: Option<String>) -> Self {
        let mut command = Command::new(env::current_exe().unwrap());
        command.args(["--exact", "fleet::process_of_a_router", "--nocapture"]);
        command.env(LISTEN, &endpoint);
        if let Some(other) = &other {
            command.env(CONNECT, other);
        }
        let command = command.stdin(Stdio::piped()).stdout(Stdio::null());
        let process = command.spawn().unwrap();
        let address = endpoint.trim_start_matches("tcp/");
        until("the router listens", || TcpStream::connect(address).is_ok());
        Self {
            endpoint,
            other,
            process,
        }
    }

    fn kill(&mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }

    fn start_again(&mut self) {
        *self = Self::start(self.endpoint.clone(), self.other.clone());
    }
}

impl Drop for Router {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Starts the bridge of a domain.
fn bridge(domain: &Domain, name: &str, router: &Router, rules: &str) -> Program {
    let head = format!("name = \"{name}\"\nprefix = \"fleet\"");
    let file = domain.write_config(&head, &router.endpoint, rules);
    Program::start(&file, &[])
}

struct Robot {
    bridge: Program,
    publisher: Publisher<[u8]>,
    published: u32,
    _domain: Domain,
}

impl Robot {
    fn start(number: usize, router: &Router) -> Self {
        let domain = Domain::new();
        let publisher = domain
            .node("driver")
            .publisher::<[u8]>(&format!("robot/{number}"));
        let bridge = bridge(&domain, &format!("robot_{number}"), router, OUT);
        let publisher = publisher.unwrap();
        until("the bridge takes the topic", || is_linked(&publisher));
        Self {
            bridge,
            publisher,
            published: 0,
            _domain: domain,
        }
    }

    /// Publishes a message with the next number, which the bridge has when this returns.
    fn publish(&mut self, random: &mut Rng) {
        self.published += 1;
        let mut payload = vec![0; 4 + random.usize(..PAYLOAD_MAX)];
        payload[..4].copy_from_slice(&self.published.to_le_bytes());
        self.publisher.publish(&payload).unwrap();
        until("the bridge has the message", || {
            let links = self.publisher.links();
            let mut counters = links.iter().filter(|it| it.open).map(|it| it.counters);
            counters.all(|it| it.delivered == it.offered)
        });
    }
}

struct Site {
    _bridge: Program,
    subscribers: Vec<Subscriber<[u8]>>,
    /// The numbers of the messages of each robot, as they came.
    received: Vec<Vec<u32>>,
    _domain: Domain,
}

impl Site {
    fn start(router: &Router) -> Self {
        let domain = Domain::new();
        let node = domain.node("map");
        let subscriber = |number| {
            let builder = node.subscriber_builder::<[u8]>(&format!("robot/{number}"));
            builder.depth(DEPTH).declare().unwrap()
        };
        Self {
            subscribers: (0..ROBOTS).map(subscriber).collect(),
            received: vec![Vec::new(); ROBOTS],
            _bridge: bridge(&domain, "site", router, IN),
            _domain: domain,
        }
    }

    fn take_all(&mut self) {
        for (subscriber, received) in self.subscribers.iter().zip(&mut self.received) {
            while let Some(sample) = subscriber.try_recv().unwrap() {
                assert_eq!(sample.lost(), 0, "the test is too slow for its own program");
                received.push(u32::from_le_bytes(sample[..4].try_into().unwrap()));
            }
        }
    }
}

struct Fleet {
    routers: [Router; 2],
    robots: Vec<Robot>,
    site: Site,
    random: Rng,
    /// How many accounts were looked at.
    looks: u64,
}

impl Fleet {
    /// The robots are at both routers in turn, and the site is at the first one.
    fn start() -> Self {
        let first = Router::start(free_endpoint(), None);
        let second = Router::start(free_endpoint(), Some(first.endpoint.clone()));
        let routers = [first, second];
        let site = Site::start(&routers[0]);
        let robot = |number| Robot::start(number, &routers[number % 2]);
        Self {
            robots: (0..ROBOTS).map(robot).collect(),
            routers,
            site,
            random: Rng::with_seed(seed()),
            looks: 0,
        }
    }

    /// Publishes in all robots for the time of a phase.
    fn run(&mut self) {
        let end = Instant::now() + PHASE;
        loop {
            for robot in &mut self.robots {
                for _ in 0..1 + self.random.usize(..2) {
                    robot.publish(&mut self.random);
                }
            }
            self.look();
            if Instant::now() > end {
                return;
            }
            thread::sleep(PAUSE);
        }
    }

    /// Looks at all accounts, which hold at each moment. Returns how many messages are handed over.
    fn look(&mut self) -> u64 {
        self.site.take_all();
        let mut handed_over = 0;
        for robot in &self.robots {
            let counts = robot.bridge.spool();
            assert!(counts.is_balanced(), "{counts:?}");
            assert!(counts.offered <= robot.published.into(), "{counts:?}");
            assert_eq!((counts.expired, counts.refused), (0, 0), "{counts:?}");
            handed_over += counts.handed_over;
            self.looks += 1;
        }
        handed_over
    }

    /// Waits until all messages are handed over, as long as there are more of them.
    fn deliver(&mut self) {
        let published = self.robots.iter().map(|it| u64::from(it.published));
        let published: u64 = published.sum();
        let (mut before, mut end) = (0, Instant::now() + SOON);
        loop {
            let handed_over = self.look();
            if handed_over == published {
                return;
            }
            if handed_over > before {
                (before, end) = (handed_over, Instant::now() + SOON);
            }
            assert!(
                Instant::now() < end,
                "{handed_over} of {published} are handed over"
            );
            thread::sleep(PAUSE);
        }
    }
}

#[test]
fn nothing_is_missing_after_a_router_was_killed() {
    let mut fleet = Fleet::start();
    fleet.run();
    fleet.routers[1].kill();
    fleet.run();
    until("messages wait for the router", || {
        fleet.robots[1].bridge.spool().spooled > 0
    });
    fleet.routers[1].start_again();
    fleet.run();
    fleet.deliver();
    until("the program at the site has all messages", || {
        fleet.site.take_all();
        let received = fleet.site.received.iter().map(Vec::len);
        let published = fleet.robots.iter().map(|it| it.published as usize);
        received.eq(published)
    });
    let mut total = 0;
    for (robot, received) in fleet.robots.iter().zip(&mut fleet.site.received) {
        received.sort_unstable();
        assert!(received.iter().copied().eq(1..=robot.published));
        total += received.len();
    }
    println!(
        "{} bridges, {total} messages, each published once at the site; {} accounts were right",
        ROBOTS + 1,
        fleet.looks
    );
}
