//! A node in Rust beside Python: doubles what it gets on `imu`, `points` and `text`. The tests of the package run it.

use std::error::Error;

use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
use sm2_node::{Message, Node};

#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "sensor/Imu")]
#[repr(C)]
struct Imu {
    stamp_ns: u64,
    acceleration: [f64; 3],
}

#[derive(Clone, Copy, Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "nav/Point")]
#[repr(C)]
struct Point {
    x: f32,
    y: f32,
    id: [u16; 2],
}

fn main() -> Result<(), Box<dyn Error>> {
    let node = Node::new("peer")?;
    let imu = node.subscriber::<Imu>("imu")?;
    let points = node.subscriber::<[Point]>("points")?;
    let text = node.subscriber::<str>("text")?;
    let doubled_imu = node.publisher::<Imu>("imu/doubled")?;
    let doubled_points = node.publisher::<[Point]>("points/doubled")?;
    let doubled_text = node.publisher::<str>("text/doubled")?;
    println!("ready");
    loop {
        // The test publishes in this order.
        let sample = imu.recv()?;
        doubled_imu.publish(&Imu {
            stamp_ns: 2 * sample.stamp_ns,
            acceleration: sample.acceleration.map(|it| 2.0 * it),
        })?;
        let sample = points.recv()?;
        let mut loan = doubled_points.loan_slice(sample.len())?;
        for (to, from) in loan.iter_mut().zip(&*sample) {
            *to = Point {
                x: 2.0 * from.x,
                ..*from
            };
        }
        loan.publish()?;
        let sample = text.recv()?;
        doubled_text.publish(&format!("{0}{0}", &*sample))?;
    }
}
