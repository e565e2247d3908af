//! The messages of the robot: its programs share them.

use serde::{Deserialize, Serialize};
use sm2_node::Message;
use zerocopy::little_endian::{U32, U64};
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// A header, followed by the pixels. Subscribers read it in shared memory. The time is that of the exposure, in
/// nanoseconds of the clock of `sm2_node::now`.
#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[message(name = "robot/Image")]
#[repr(C)]
pub struct Image {
    pub time_ns: U64,
    pub width: U32,
    pub height: U32,
    pub pixels: [u8],
}

/// The bright objects in one image, by their bearings in radians, positive to the left. The time is that of the image.
#[derive(Message, Serialize, Deserialize)]
#[message(name = "robot/Detections", encoding = "postcard")]
pub struct Detections {
    pub time_ns: u64,
    pub bearings: Vec<f32>,
}

/// The work of the detector since its start.
#[derive(Message, Serialize, Deserialize, Default)]
#[message(name = "robot/DetectorState", encoding = "postcard")]
pub struct DetectorState {
    pub images: u64,
    pub lost: u64,
    pub objects: u64,
}

/// The places of obstacles: metres ahead of the robot, and metres to its left.
#[derive(Message, Serialize, Deserialize)]
#[message(name = "robot/Map", encoding = "postcard")]
pub struct Map {
    pub time_ns: u64,
    pub obstacles: Vec<(f32, f32)>,
}

/// The motor stands from a message with `on`, until one without.
#[derive(Message, Serialize, Deserialize)]
#[message(name = "robot/Stop", encoding = "postcard")]
pub struct Stop {
    pub on: bool,
    pub reason: String,
}
