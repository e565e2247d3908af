//! Bytes as messages of ROS 2, by definitions and by Rust types.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_ros::fuzz::ros_message(data));
