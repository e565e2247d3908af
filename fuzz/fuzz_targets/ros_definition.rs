//! Texts as definitions of ROS 2.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sm2_ros::fuzz::ros_definition(data));
