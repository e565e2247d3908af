//! Other subscribers while a viewer looks at a topic of large messages.
//!
//! `cargo bench --bench beside` prints the 99th percentile of two latencies: that of a subscriber of images of 10 MB at
//! 10 Hz, and that of a subscriber of images of 64 B at 1 kHz. Once without a viewer, and once with one that looks at
//! the images. Five runs of each, in turn.

use std::env;
use std::error::Error;
use std::io::{BufRead as _, BufReader};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use sm2_node::{Node, Rate, Subscriber, now};
use sm2_ros::sensor_msgs::msg::Image;
use tungstenite::client::IntoClientRequest;
use tungstenite::http::header::{HeaderValue, SEC_WEBSOCKET_PROTOCOL};
use tungstenite::protocol::WebSocketConfig;
use tungstenite::{Message, client::client_with_config};

const RUNS: usize = 5;
const TIME: Duration = Duration::from_secs(15);
/// The time at the beginning that is left out.
const WARM_UP: Duration = Duration::from_secs(1);
/// How long nothing may come.
const TIMEOUT: Duration = Duration::from_secs(60);
/// Bytes of a message and its rate in Hz.
const TOPICS: [(&str, usize, u32); 2] = [("image", 10_000_000, 10), ("pose", 64, 1_000)];

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

fn main() -> Result<()> {
    let arguments: Vec<String> = env::args().collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [_, "publisher", socket, topic] => publish(socket.as_ref(), topic.parse()?),
        [_, "viewer", url] => view(url),
        _ => compare(),
    }
}

/// Publishes a topic until it is killed.
fn publish(socket: &Path, topic: usize) -> Result<()> {
    let (name, len, rate_hz) = TOPICS[topic];
    let publisher = connect(socket, &format!("publisher-{name}"))?.publisher::<Image>(name)?;
    let image = Image {
        data: vec![7; len],
        ..Image::default()
    };
    let mut pace = Rate::hz(rate_hz);
    loop {
        publisher.publish(&image)?;
        pace.sleep();
    }
}

/// Looks at the images, and prints the number of those that came in each second, until it is killed.
fn view(url: &str) -> Result<()> {
    let address = url
        .strip_prefix("ws://")
        .and_then(|it| it.split('/').next());
    let stream = TcpStream::connect(address.ok_or("not a URL")?)?;
    stream.set_read_timeout(Some(TIMEOUT))?;
    let mut request = url.into_client_request()?;
    let protocol = HeaderValue::from_static("foxglove.sdk.v1");
    request
        .headers_mut()
        .insert(SEC_WEBSOCKET_PROTOCOL, protocol);
    let config = WebSocketConfig::default()
        .max_frame_size(None)
        .max_message_size(None);
    let (mut socket, _) = client_with_config(request, stream, Some(config))?;
    let mut is_first = true;
    loop {
        match socket.read()? {
            Message::Text(text) => {
                let message = serde_json::from_str(&text)?;
                let Some(channel) = channel_of_images(&message) else {
                    continue;
                };
                let subscription = json!({"id": 1, "channelId": channel});
                let subscribe = json!({"op": "subscribe", "subscriptions": [subscription]});
                socket.send(Message::text(subscribe.to_string()))?;
            }
            Message::Binary(bytes) if bytes.len() > TOPICS[0].1 && is_first => {
                is_first = false;
                println!("an image");
            }
            _ => {}
        }
    }
}

fn channel_of_images(message: &Value) -> Option<&Value> {
    let channels = message["channels"].as_array()?;
    let images = channels.iter().find(|it| it["topic"] == TOPICS[0].0)?;
    Some(&images["id"])
}

fn compare() -> Result<()> {
    let mut found = [const { [const { Vec::new() }; TOPICS.len()] }; 2];
    for _ in 0..RUNS {
        for is_viewed in [false, true] {
            let p99_us = run(is_viewed)?;
            for (all, value) in found[usize::from(is_viewed)].iter_mut().zip(p99_us) {
                all.push(value);
            }
        }
    }
    println!("| topic | viewer | 99th percentile, us (median, least and most of {RUNS}) |");
    println!("| --- | --- | --- |");
    for (topic, (name, ..)) in TOPICS.iter().enumerate() {
        for (viewer, all) in ["no", "yes"].iter().zip(&mut found) {
            let values: &mut Vec<f64> = &mut all[topic];
            values.sort_by(f64::total_cmp);
            let (least, median, most) = (values[0], values[RUNS / 2], values[RUNS - 1]);
            println!("| {name} | {viewer} | {median:.0} ({least:.0}-{most:.0}) |");
        }
    }
    Ok(())
}

/// The 99th percentile of each topic's latency, in microseconds.
fn run(is_viewed: bool) -> Result<[f64; TOPICS.len()]> {
    let folder = tempfile::tempdir()?;
    let socket = folder.path().join("sock");
    let _manager = sm2_manager::Background::start(&socket, sm2_manager::Options::default())?;
    let node = connect(&socket, "subscriber")?;
    let mut publishers = Vec::new();
    for topic in 0..TOPICS.len() {
        let mut publisher = Command::new(env::current_exe()?);
        publisher
            .arg("publisher")
            .arg(&socket)
            .arg(topic.to_string());
        publishers.push(Running(publisher.spawn()?));
    }
    let mut server = Command::new(env!("CARGO_BIN_EXE_sm2-foxglove"));
    server
        .arg("--socket")
        .arg(&socket)
        .args(["--listen", "127.0.0.1:0"]);
    let (_server, url) = Running::and_line(&mut server)?;
    let _viewer = match is_viewed {
        true => {
            let mut viewer = Command::new(env::current_exe()?);
            Some(Running::and_line(viewer.args(["viewer", &url]))?)
        }
        false => None,
    };
    let measured = TOPICS.map(|(name, ..)| {
        let subscriber = node.subscriber_builder::<[u8]>(name).any_type().declare();
        thread::spawn(move || receive(&subscriber?))
    });
    let mut p99_us = [0.0; TOPICS.len()];
    for (p99_us, thread) in p99_us.iter_mut().zip(measured) {
        let mut latencies = thread.join().map_err(|_| "a thread panicked")??;
        latencies.sort_by(f64::total_cmp);
        *p99_us = latencies[latencies.len() * 99 / 100];
    }
    Ok(p99_us)
}

/// The latencies, in microseconds, of the messages of a while.
fn receive(subscriber: &Subscriber<[u8]>) -> Result<Vec<f64>> {
    let begin = Instant::now();
    let mut latencies = Vec::new();
    while begin.elapsed() < WARM_UP + TIME {
        let Some(sample) = subscriber.recv_timeout(TIMEOUT)? else {
            return Err("no messages".into());
        };
        let latency = now().since(sample.source_time());
        if begin.elapsed() > WARM_UP {
            latencies.push(latency.as_secs_f64() * 1e6);
        }
    }
    Ok(latencies)
}

fn connect(socket: &Path, name: &str) -> Result<Node> {
    Ok(Node::builder(name).socket(socket).connect()?)
}

/// A process that ends with its owner.
struct Running(Child);

impl Running {
    /// Starts it, and waits for its first line.
    fn and_line(command: &mut Command) -> Result<(Self, String)> {
        let mut child = Self(command.stdout(Stdio::piped()).spawn()?);
        let mut line = String::new();
        let output = child.0.stdout.take().ok_or("no output")?;
        if BufReader::new(output).read_line(&mut line)? == 0 {
            return Err("a process has ended".into());
        }
        Ok((child, line.trim_end().to_owned()))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
