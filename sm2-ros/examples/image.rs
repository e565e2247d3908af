//! Publishes an image of ROS 2 and prints the one that a subscriber receives.
//!
//! `cargo run -p sm2-ros --example image` in a domain whose Manager runs (`sm2 manager`).

use std::time::Duration;

use sm2_node::Node;
use sm2_ros::sensor_msgs::msg::Image;
use sm2_ros::std_msgs::msg::Header;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let camera = Node::new("camera")?;
    let images = camera.publisher::<Image>("image")?;
    let viewer = Node::new("viewer")?;
    let subscriber = viewer.subscriber::<Image>("image")?;

    images.wait_for_subscribers_timeout(1, Duration::from_secs(5))?;
    images.publish(&Image {
        header: Header {
            frame_id: "front".to_owned(),
            ..Header::default()
        },
        height: 480,
        width: 640,
        encoding: "mono8".to_owned(),
        step: 640,
        data: vec![0; 640 * 480],
        ..Image::default()
    })?;

    let timeout = Duration::from_secs(5);
    let image = subscriber.recv_timeout(timeout)?.ok_or("no image came")?;
    println!(
        "{}x{} of {}",
        image.width, image.height, image.header.frame_id
    );
    Ok(())
}
