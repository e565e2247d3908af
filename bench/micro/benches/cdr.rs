//! The time to encode and to decode messages in CDR, beside that of copying their bytes.
//!
//! `cargo bench --bench cdr [-- PART_OF_A_NAME]`
//!
//! Encoding computes the length and writes into memory that is there, as a publisher does. Decoding allocates the
//! memory of the message. A view leaves the numbers where they are, and copies the rest.

use std::hint::black_box;
use std::time::{Duration, Instant};

use sm2_ros::cdr::{encoded_len, from_slice, to_vec, write_into};
use sm2_ros::geometry_msgs::msg::{Quaternion, Transform, TransformStamped, Vector3};
use sm2_ros::sensor_msgs::msg::{Image, JointState, PointCloud2, PointField};
use sm2_ros::std_msgs::msg::Header;
use sm2_ros::tf2_msgs::msg::TFMessage;
use sm2_ros::{Viewed, view};

/// How long one measurement takes, at least.
const BATCH: Duration = Duration::from_millis(20);
/// The number of measurements. Their median counts.
const BATCHES: usize = 15;

fn main() {
    // Cargo passes `--bench`.
    let part = std::env::args().skip(1).find(|it| !it.starts_with("--"));
    let part = part.unwrap_or_default();
    println!(
        "{:<12} {:>9} {:>10} {:>10} {:>7} {:>10} {:>7} {:>8}",
        "message", "bytes", "memcpy ns", "encode ns", "ratio", "decode ns", "ratio", "view ns"
    );
    measure(&part, "Image", &image());
    measure(&part, "PointCloud2", &point_cloud());
    measure(&part, "JointState", &joint_state());
    measure(&part, "TFMessage", &transforms());
}

fn measure<T: Viewed>(part: &str, name: &str, message: &T) {
    if !name.contains(part) {
        return;
    }
    let bytes = to_vec(message).expect("a legal message");
    assert!(from_slice::<T>(&bytes).as_ref() == Ok(message));
    let mut copy = bytes.clone();
    let memcpy = median_ns(|| black_box(&mut copy).copy_from_slice(black_box(&bytes)));
    let encode = median_ns(|| {
        let message = black_box(message);
        let len = encoded_len(message).expect("a legal message");
        write_into(message, &mut copy[..len]).expect("the length is right");
        black_box(&copy);
    });
    let decode = median_ns(|| {
        black_box(from_slice::<T>(black_box(&bytes)).expect("a message"));
    });
    let view = median_ns(|| {
        black_box(view::<T>(black_box(&bytes)).expect("a message"));
    });
    println!(
        "{name:<12} {:>9} {memcpy:>10.0} {encode:>10.0} {:>7.2} {decode:>10.0} {:>7.2} {view:>8.0}",
        bytes.len(),
        encode / memcpy,
        decode / memcpy,
    );
}

/// The time of one call, in nanoseconds.
fn median_ns(mut call: impl FnMut()) -> f64 {
    let mut time = |calls: u32| {
        let start = Instant::now();
        for _ in 0..calls {
            call();
        }
        start.elapsed()
    };
    let mut calls = 1;
    while time(calls) < BATCH {
        calls *= 2;
    }
    let mut times = [0.0; BATCHES];
    times.fill_with(|| time(calls).as_nanos() as f64 / f64::from(calls));
    times.sort_by(f64::total_cmp);
    times[BATCHES / 2]
}

fn header() -> Header {
    Header {
        frame_id: "front_camera".to_owned(),
        ..Header::default()
    }
}

fn image() -> Image {
    Image {
        header: header(),
        height: 1_024,
        width: 1_024,
        encoding: "mono8".to_owned(),
        step: 1_024,
        data: (0..1 << 20).map(|at| at as u8).collect(),
        ..Image::default()
    }
}

fn point_cloud() -> PointCloud2 {
    let fields = ["x", "y", "z", "intensity"].iter().zip([0, 4, 8, 12]);
    let fields = fields.map(|(name, offset)| PointField {
        name: (*name).to_owned(),
        offset,
        datatype: PointField::FLOAT32,
        count: 1,
    });
    let points = 32_768;
    PointCloud2 {
        header: header(),
        height: 1,
        width: points,
        fields: fields.collect(),
        point_step: 16,
        row_step: 16 * points,
        data: (0..16 * points).map(|at| at as u8).collect(),
        is_dense: true,
        ..PointCloud2::default()
    }
}

fn joint_state() -> JointState {
    let joints = 0..7;
    let values: Vec<_> = joints.clone().map(f64::from).collect();
    JointState {
        header: header(),
        name: joints.map(|it| format!("joint_{it}")).collect(),
        position: values.clone(),
        velocity: values.clone(),
        effort: values,
    }
}

fn transforms() -> TFMessage {
    let transform = |at: u32| TransformStamped {
        header: header(),
        child_frame_id: format!("link_{at}"),
        transform: Transform {
            translation: Vector3 {
                x: f64::from(at),
                ..Vector3::default()
            },
            rotation: Quaternion::default(),
        },
    };
    TFMessage {
        transforms: (0..10).map(transform).collect(),
    }
}
