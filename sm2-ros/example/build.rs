//! Generates the types of the package `my_msgs`.

fn main() -> Result<(), sm2_ros_build::Error> {
    sm2_ros_build::Builder::new()
        .package("msgs/my_msgs")
        .generate()
}
