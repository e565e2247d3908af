//! Texts as definitions of ROS 2.
// Shows TYP-DEFINITION (libFuzzer).
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_ros::fuzz::ros_definition(data));
