//! The other side of sm2-cpp/tests/rust_peer.cpp: types of Rust that must be those of C++.

use sm2_node::{Message, Node};
use sm2_test_support::SOON;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

#[derive(Clone, Copy, Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "robot/Vector")]
#[repr(C)]
struct Vector {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Clone, Copy, Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "robot/Imu")]
#[repr(C)]
struct Imu {
    stamp_ns: u64,
    acceleration: Vector,
    orientation: [f32; 4],
    temperature: [i16; 3],
    state: u8,
    padding: u8,
}

/// A type that C++ declares with other fields.
#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "robot/Pose")]
#[repr(C)]
struct Pose {
    x: f64,
    heading: f64,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let node = Node::new("rust-peer")?;
    let _poses = node.publisher::<Pose>("peer/pose")?;
    let imu = node.publisher::<Imu>("peer/imu")?;
    let sums = node.server::<[f64], f64>("peer/sum")?;
    let vectors = node.subscriber::<[Vector]>("peer/vectors")?;

    // C++ calls when it is ready for messages.
    let request = sums.recv_timeout(SOON)?.ok_or("no call")?;
    let sum = request.iter().sum();
    request.reply(&sum)?;

    imu.wait_for_subscribers_timeout(1, SOON)?;
    imu.publish(&Imu {
        stamp_ns: 7,
        acceleration: Vector {
            x: 0.0,
            y: -9.81,
            z: 1.0,
        },
        orientation: [1.0, 2.0, 3.0, 4.0],
        temperature: [-40, 20, 85],
        state: 3,
        padding: 0,
    })?;
    let received = vectors.recv_timeout(SOON)?.ok_or("no vectors")?;
    let last = received.last().ok_or("no vector")?;
    assert_eq!((received.len(), last.x, last.z), (3, 2.5, -1.0));
    imu.flush_timeout(SOON)?;
    Ok(())
}
