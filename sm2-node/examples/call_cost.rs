//! Measures the cost of a service call for the two processes that take part: `call_cost [BYTES]`.
//!
//! Client and server are nodes of one thread, so no thread sleeps or waits for another core. The result is the time
//! that the library needs. Prints nanoseconds per call, the median of nine rounds: sending the request, serving it, and
//! taking the reply. `valgrind --tool=callgrind` attributes the instructions.

#[path = "common/cost.rs"]
mod cost;

use std::time::Instant;

use cost::{Domain, median};
use sm2_node::{Client, Server};

const ROUNDS: usize = 9;
const CALLS: usize = 10_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let bytes = cost::bytes()?;
    let domain = Domain::new()?;
    let node = |name: &str| domain.node(name).connect();
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
