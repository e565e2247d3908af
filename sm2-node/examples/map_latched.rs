//! A map that is published once, and reaches subscribers that come later: `map_latched`.

use std::error::Error;
use std::process::ExitCode;
use std::thread;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use sm2_node::{Message, Node, Schema};

#[derive(Message, Serialize, Deserialize)]
#[message(name = "nav/Map", encoding = "postcard")]
struct Map {
    name: String,
    landmarks: Vec<Landmark>,
}

/// A part of a message: it needs a schema, and no name.
#[derive(Schema, Serialize, Deserialize)]
struct Landmark {
    name: String,
    x: f64,
    y: f64,
}

/// Also of a thread.
type Outcome = Result<(), Box<dyn Error + Send + Sync>>;

fn main() -> ExitCode {
    match serve() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("map_latched: {error}");
            ExitCode::FAILURE
        }
    }
}

fn serve() -> Outcome {
    let node = Node::new("map-server")?;
    let publisher = node.publisher_builder::<Map>("map").latched(1).declare()?;
    publisher.publish(&Map {
        name: "ground floor".to_owned(),
        landmarks: vec![landmark("door", 1.0, 2.5), landmark("dock", 7.25, 0.0)],
    })?;

    let late = thread::spawn(navigate);
    // The late subscriber is served while the map server is called.
    while !late.is_finished() {
        node.spin_once_timeout(Duration::from_millis(100))?;
    }
    late.join().expect("the navigator does not panic")
}

fn landmark(name: &str, x: f64, y: f64) -> Landmark {
    let name = name.to_owned();
    Landmark { name, x, y }
}

fn navigate() -> Outcome {
    let node = Node::new("navigator")?;
    let map = node.subscriber::<Map>("map")?.recv()?;
    println!("{}:", map.name);
    for Landmark { name, x, y } in &map.landmarks {
        println!("  {name} at {x}, {y}");
    }
    Ok(())
}
