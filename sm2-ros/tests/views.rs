//! Messages that are read in place.

use sm2_ros::cdr::{Numbers, from_slice, to_vec};
use sm2_ros::geometry_msgs::msg::PolygonStamped;
use sm2_ros::sensor_msgs::msg::{JointState, LaserScan};
use sm2_ros::trajectory_msgs::msg::{JointTrajectory, JointTrajectoryPoint};
use sm2_ros::{DecodeError, Fault, view};

/// A copy whose first byte is at a multiple of 8, or `skip` bytes behind it.
fn aligned(bytes: &[u8], skip: usize) -> (Vec<u64>, std::ops::Range<usize>) {
    let mut memory = vec![0_u64; bytes.len() / 8 + 3];
    let place = skip..skip + bytes.len();
    let all = zerocopy::IntoBytes::as_mut_bytes(memory.as_mut_slice());
    all[place.clone()].copy_from_slice(bytes);
    (memory, place)
}

fn scan() -> LaserScan {
    LaserScan {
        ranges: vec![0.5, -1.0, f32::INFINITY],
        ..LaserScan::default()
    }
}

/// The numbers of a view, with each way to read them.
fn check<T>(numbers: Numbers<'_, T>, expected: &[T])
where
    T: sm2_ros::cdr::Number + PartialEq,
{
    assert_eq!(numbers.len(), expected.len());
    assert_eq!(numbers.is_empty(), expected.is_empty());
    assert_eq!(numbers.to_vec(), expected);
    assert!(numbers.iter().eq(expected.iter().copied()));
    for (at, number) in expected.iter().enumerate() {
        assert_eq!(numbers.get(at), Some(*number));
    }
    for beyond in [expected.len(), usize::MAX / size_of::<T>(), usize::MAX] {
        assert_eq!(numbers.get(beyond), None, "{beyond}");
    }
}

#[test]
fn numbers_are_a_slice_if_they_are_aligned_and_in_order() {
    let scan = scan();
    let bytes = to_vec(&scan).unwrap();
    for (skip, has_slice) in [(0, true), (4, true), (1, false), (2, false)] {
        let (memory, place) = aligned(&bytes, skip);
        let bytes = &zerocopy::IntoBytes::as_bytes(memory.as_slice())[place];
        let view = view::<LaserScan>(bytes).unwrap();
        check(view.ranges, &scan.ranges);
        let slice = has_slice.then_some(scan.ranges.as_slice());
        assert_eq!(view.ranges.as_slice(), slice, "{skip}");
        check(view.intensities, &[]);
    }
}

#[test]
fn numbers_in_the_other_byte_order_are_converted() {
    // A header with an empty name, then the angles, the times and the limits, all 0: 13 words before the numbers.
    let mut bytes = vec![0; 4 + 4 * 4 + 7 * 4];
    // The length of the name, and the byte 0 at its end with 3 bytes behind it.
    bytes[4 + 2 * 4 + 3] = 1;
    bytes.extend(2_u32.to_be_bytes());
    bytes.extend(1.5_f32.to_be_bytes());
    bytes.extend((-2.0_f32).to_be_bytes());
    bytes.extend(0_u32.to_be_bytes());
    assert_eq!(from_slice::<LaserScan>(&bytes).unwrap().ranges, [1.5, -2.0]);
    let view = view::<LaserScan>(&bytes).unwrap();
    check(view.ranges, &[1.5, -2.0]);
    assert_eq!(view.ranges.as_slice(), None);
}

#[test]
fn numbers_of_eight_bytes_have_other_ways() {
    let state = JointState {
        name: vec!["elbow".to_owned()],
        position: vec![1.0, 2.0],
        ..JointState::default()
    };
    let bytes = to_vec(&state).unwrap();
    let view = view::<JointState>(&bytes).unwrap();
    assert_eq!(view.name, state.name);
    check(view.position, &[1.0, 2.0]);
}

/// The views of the parts are inside.
#[test]
fn parts_are_views_too() {
    let point = JointTrajectoryPoint {
        positions: vec![1.0, 2.0],
        ..JointTrajectoryPoint::default()
    };
    let trajectory = JointTrajectory {
        points: vec![JointTrajectoryPoint::default(), point],
        ..JointTrajectory::default()
    };
    let bytes = to_vec(&trajectory).unwrap();
    let view = view::<JointTrajectory>(&bytes).unwrap();
    assert_eq!(view.points.len(), 2);
    check(view.points[0].positions, &[]);
    check(view.points[1].positions, &[1.0, 2.0]);
}

/// A type without sequences of numbers is its own view.
#[test]
fn a_type_without_numbers_is_its_own_view() {
    let polygon = PolygonStamped::default();
    let bytes = to_vec(&polygon).unwrap();
    let view: PolygonStamped = view::<PolygonStamped>(&bytes).unwrap();
    assert_eq!(view, polygon);
}

#[test]
fn a_length_beyond_the_message_is_refused() {
    let bytes = to_vec(&scan()).unwrap();
    let at = bytes.len() - 4 - 3 * 4 - 4;
    for len in [4_u32, 5, u32::MAX] {
        let mut bytes = bytes.clone();
        bytes[at..at + 4].copy_from_slice(&len.to_le_bytes());
        let error = view::<LaserScan>(&bytes).unwrap_err();
        assert_eq!(Some(&error), from_slice::<LaserScan>(&bytes).err().as_ref());
        let DecodeError::Value { fault, path, .. } = error else {
            panic!("{error}");
        };
        // One more number is the length of the next sequence.
        let (expected, field) = match len {
            4 => (Fault::Short, "intensities"),
            _ => (Fault::Short, "ranges"),
        };
        assert_eq!((fault, &*path.to_string()), (expected, field), "{len}");
    }
}
