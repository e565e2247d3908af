//! A domain to look at with `sm2 view` or `sm2 top`: robots, each with five nodes, and one node that watches them.
//! One pair of nodes has different names for a topic, and is not linked.
//!
//! ```text
//! sm2 manager --socket /tmp/sm2.sock
//! cargo run --release -p sm2-cli --example fleet -- /tmp/sm2.sock [ROBOTS] [SECONDS]
//! sm2 view --socket /tmp/sm2.sock
//! ```
//!
//! With one robot, names have no prefix.

use std::{
    env,
    error::Error,
    thread,
    time::{Duration, Instant},
};

use sm2_node::{Client, Node, Publisher, Server, Subscriber};

/// The time between two rounds, where each topic may have a message.
const PERIOD: Duration = Duration::from_millis(20);

type Done<T = ()> = Result<T, Box<dyn Error>>;

fn main() -> Done {
    let arguments: Vec<_> = env::args().skip(1).collect();
    let number = |at: usize, default| arguments.get(at).map_or(Ok(default), |text| text.parse());
    let socket = arguments.first().ok_or("name the Manager's socket")?;
    let (robots, seconds) = (number(1, 1)?, number(2, 3600)?);
    let mut fleet = Fleet::default();
    for robot in 0..robots {
        let prefix = match robots {
            1 => String::new(),
            _ => format!("robot{robot:02}/"),
        };
        fleet.add_robot(socket, &prefix)?;
    }
    let monitor = fleet.node(socket, "monitor")?;
    for robot in fleet.prefixes.clone() {
        fleet.take(monitor, &format!("{robot}battery"))?;
    }
    let end = Instant::now() + Duration::from_secs(seconds);
    for round in 0.. {
        let due = Instant::now() + PERIOD;
        if due > end {
            break;
        }
        fleet.run(round)?;
        thread::sleep(due.saturating_duration_since(Instant::now()));
    }
    Ok(())
}

/// All nodes and interfaces.
#[derive(Default)]
struct Fleet {
    prefixes: Vec<String>,
    nodes: Vec<Node>,
    sources: Vec<Source>,
    subscribers: Vec<Subscriber<[u8]>>,
    clients: Vec<Client<u64, u64>>,
    servers: Vec<Server<u64, u64>>,
}

/// A publisher, the length of its messages in bytes, and how many rounds pass between two of them.
struct Source {
    publisher: Publisher<[u8]>,
    message: Vec<u8>,
    rounds: u64,
}

impl Fleet {
    fn add_robot(&mut self, socket: &str, prefix: &str) -> Done {
        let name = |name: &str| format!("{prefix}{name}");
        let camera = self.node(socket, &name("camera"))?;
        let lidar = self.node(socket, &name("lidar"))?;
        let detector = self.node(socket, &name("detector"))?;
        let planner = self.node(socket, &name("planner"))?;
        let base = self.node(socket, &name("base"))?;
        self.publish(camera, &name("image"), 60_000, 2)?;
        self.publish(lidar, &name("scan"), 12_000, 5)?;
        self.publish(detector, &name("objects"), 900, 2)?;
        self.publish(planner, &name("cmd_vel"), 48, 1)?;
        self.publish(base, &name("odom"), 120, 1)?;
        self.publish(base, &name("battery"), 16, 50)?;
        self.take(detector, &name("image"))?;
        self.take(detector, &name("scan"))?;
        self.take(planner, &name("objects"))?;
        self.take(planner, &name("odom"))?;
        self.take(base, &name("cmd_vel"))?;
        // A misspelt name: the planner hears no lidar.
        self.take(planner, &name("scans"))?;
        self.servers
            .push(self.nodes[planner].server(&name("plan"))?);
        self.clients.push(self.nodes[base].client(&name("plan"))?);
        self.prefixes.push(prefix.to_owned());
        Ok(())
    }

    fn node(&mut self, socket: &str, name: &str) -> Done<usize> {
        self.nodes
            .push(Node::builder(name).socket(socket).connect()?);
        Ok(self.nodes.len() - 1)
    }

    fn publish(&mut self, node: usize, topic: &str, len_bytes: usize, rounds: u64) -> Done {
        let publisher = self.nodes[node].publisher(topic)?;
        self.sources.push(Source {
            publisher,
            message: vec![0; len_bytes],
            rounds,
        });
        Ok(())
    }

    fn take(&mut self, node: usize, topic: &str) -> Done {
        self.subscribers.push(self.nodes[node].subscriber(topic)?);
        Ok(())
    }

    /// Publishes what is due, and takes what has come.
    fn run(&self, round: u64) -> Done {
        for source in self
            .sources
            .iter()
            .filter(|it| round.is_multiple_of(it.rounds))
        {
            source.publisher.publish(&source.message)?;
        }
        for subscriber in &self.subscribers {
            while subscriber.try_recv()?.is_some() {}
        }
        Ok(())
    }
}
