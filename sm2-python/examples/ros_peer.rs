//! A node in Rust beside Python: returns the messages of ROS 2 that it gets, each with one change. The tests of the
//! package run it.

use std::error::Error;

use sm2_node::Node;
use sm2_ros::sensor_msgs::msg::{Image, PointCloud2};
use sm2_ros::std_msgs::msg::String as Text;

fn main() -> Result<(), Box<dyn Error>> {
    let node = Node::new("peer")?;
    let strings = node.subscriber::<Text>("ros/string")?;
    let images = node.subscriber::<Image>("ros/image")?;
    let clouds = node.subscriber::<PointCloud2>("ros/cloud")?;
    let string_echo = node.publisher::<Text>("ros/string/echo")?;
    let image_echo = node.publisher::<Image>("ros/image/echo")?;
    let cloud_echo = node.publisher::<PointCloud2>("ros/cloud/echo")?;
    println!("ready");
    loop {
        // The test publishes in this order.
        let sample = strings.recv()?;
        string_echo.publish(&Text {
            data: format!("{}!", sample.data),
        })?;
        let sample = images.recv()?;
        let mut image = Image::clone(&sample);
        image.width += 1;
        image_echo.publish(&image)?;
        let sample = clouds.recv()?;
        let mut cloud = PointCloud2::clone(&sample);
        cloud.is_dense = false;
        cloud_echo.publish(&cloud)?;
    }
}
