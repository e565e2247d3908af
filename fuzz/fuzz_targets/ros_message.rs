//! Bytes as messages of ROS 2, by definitions and by Rust types.
// Shows TYP-CDR (libFuzzer), bound: the common interfaces, and definitions that come with the message.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_ros::fuzz::ros_message(data));
