//! The driver as a process, in a domain of the test's own.

use std::error::Error;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use sm2_manager::Options;
use sm2_node::Node;

/// Ends the process together with the test.
struct Driver(Child);

impl Drop for Driver {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn it_stops_in_front_of_an_obstacle() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let socket = folder.path().join("sm2.sock");
    let test = Node::builder("test")
        .socket(&socket)
        .embed_manager(Options::default())
        .startup_timeout(Duration::from_secs(10))
        .connect()?;
    let distances = test.publisher::<f64>("distance")?;
    let speeds = test.subscriber::<f64>("speed")?;
    let mut command = Command::new(env!("CARGO_BIN_EXE_driver"));
    let command = command
        .env("SM2_SOCKET", &socket)
        .env("SM2_PARAM_SPEED", "0.7");
    let _driver = Driver(command.spawn()?);

    for (distance, expected) in [(5.0, 0.7), (0.5, 0.0), (5.0, 0.7)] {
        let start = Instant::now();
        loop {
            distances.publish(&distance)?;
            match speeds.recv_timeout(Duration::from_millis(100))? {
                Some(speed) if *speed == expected => break,
                _ => assert!(
                    start.elapsed() < Duration::from_secs(60),
                    "no speed {expected}"
                ),
            }
        }
    }
    Ok(())
}
