//! The driver as a process, in a domain of the test's own.

use std::process::Child;
use std::time::{Duration, Instant};

use sm2_node::testing::TestDomain;

/// Ends the process together with the test.
struct Driver(Child);

impl Drop for Driver {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn it_stops_in_front_of_an_obstacle() -> anyhow::Result<()> {
    let domain = TestDomain::new()?;
    let test = domain.node("test")?;
    let distances = test.publisher::<f64>("distance")?;
    let speeds = test.subscriber::<f64>("speed")?;
    let mut driver = domain.command(env!("CARGO_BIN_EXE_driver"));
    let _driver = Driver(driver.env("SM2_PARAM_SPEED", "0.7").spawn()?);

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
