//! Measures the cost of a service call for the two processes that take part: `call_cost [BYTES]`.
//!
//! Client and server are nodes of one thread, so no thread sleeps or waits for another core. The result is the time
//! that the library needs. Prints nanoseconds per call, the median of nine rounds: sending the request, serving it, and
//! taking the reply. `valgrind --tool=callgrind` attributes the instructions.

use std::time::Instant;

use sm2_manager::{Background, Options};
use sm2_node::{Client, Node, Server};

const ROUNDS: usize = 9;
const CALLS: usize = 10_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let bytes = match std::env::args().nth(1) {
        Some(argument) => argument.parse()?,
        None => 64,
    };
    let folder = tempfile::tempdir()?;
    let socket = folder.path().join("domain.sock");
    let _manager = Background::start(&socket, Options::default())?;
    let node = |name: &str| Node::builder(name).socket(&socket).connect();
    let (asker, answerer) = (node("asker")?, node("answerer")?);
    let server = answerer.server::<[u8], [u8]>("service")?;
    let client = asker.client::<[u8], [u8]>("service")?;
    client.wait_for_servers(1)?;
    let request = vec![1; bytes];
    let mut rounds = Vec::new();
    for _ in 0..ROUNDS {
        let mut sums = [0.0; 3];
        for _ in 0..CALLS {
            let parts = call(&client, &server, &request)?;
            sums.iter_mut()
                .zip(parts)
                .for_each(|(sum, part)| *sum += part);
        }
        rounds.push(sums.map(|sum| sum * 1e9 / CALLS as f64));
    }
    println!("{bytes} bytes, ns per call: send, serve, take the reply");
    for part in 0..3 {
        print!(
            " {:>8.0}",
            median(rounds.iter().map(|it| it[part]).collect())
        );
    }
    println!();
    Ok(())
}

/// Makes one call. Returns the seconds that each of its parts took.
fn call(
    client: &Client<[u8], [u8]>,
    server: &Server<[u8], [u8]>,
    request: &[u8],
) -> Result<[f64; 3], Box<dyn std::error::Error>> {
    let begin = Instant::now();
    let mut call = client.send(request)?;
    let sent = Instant::now();
    loop {
        if let Some(request) = server.try_recv()? {
            request.reply(&[0; 8])?;
            break;
        }
    }
    let served = Instant::now();
    while call.try_wait()?.is_none() {}
    let parts = [sent - begin, served - sent, served.elapsed()];
    Ok(parts.map(|part| part.as_secs_f64()))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
