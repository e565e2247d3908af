//! A map that is published once, and reaches subscribers that come later: `map_latched`.

mod common;

use std::io::{Write, stdout};
use std::process::ExitCode;
use std::thread;
use std::time::Duration;

use common::Outcome;
use serde::{Deserialize, Serialize};
use sm2_node::{Message, Node};

#[derive(Message, Serialize, Deserialize)]
#[message(name = "nav/Map", encoding = "postcard")]
struct Map {
    name: String,
    landmarks: Vec<(String, f64, f64)>,
}

fn main() -> ExitCode {
    common::run(serve)
}

fn serve() -> Outcome {
    let node = Node::new("map-server")?;
    let publisher = node.publisher_builder::<Map>("map").latched(1).declare()?;
    publisher.publish(&Map {
        name: "ground floor".to_owned(),
        landmarks: vec![
            ("door".to_owned(), 1.0, 2.5),
            ("dock".to_owned(), 7.25, 0.0),
        ],
    })?;

    let late = thread::spawn(navigate);
    // The late subscriber is served while the map server is called.
    while !late.is_finished() {
        node.spin_once_timeout(Duration::from_millis(100))?;
    }
    late.join().expect("the navigator does not panic")
}

fn navigate() -> Outcome {
    let node = Node::new("navigator")?;
    let map = node.subscriber::<Map>("map")?.recv()?;
    let mut out = stdout();
    writeln!(out, "{}:", map.name)?;
    for (landmark, x, y) in &map.landmarks {
        writeln!(out, "  {landmark} at {x}, {y}")?;
    }
    Ok(())
}
