//! Publishes an image of ROS 2. The subscriber reads the pixels where the publisher put them.
//!
//! `cargo run -p sm2-ros --example image_in_place` in a domain whose Manager runs (`sm2 manager`).

use std::time::Duration;

use sm2_node::{Message, Node};
use sm2_ros::sensor_msgs::msg::Image;
use sm2_ros::view;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let camera = Node::new("camera")?;
    let images = camera.publisher::<Image>("image")?;
    let viewer = Node::new("viewer")?;
    // The bytes of messages of this type.
    let subscriber = viewer.subscriber_builder::<[u8]>("image");
    let subscriber = subscriber.type_id(Image::type_id()).declare()?;

    images.wait_for_subscribers_timeout(1, Duration::from_secs(5))?;
    images.publish(&Image {
        height: 480,
        width: 640,
        encoding: "mono8".to_owned(),
        step: 640,
        data: vec![7; 640 * 480],
        ..Image::default()
    })?;

    let timeout = Duration::from_secs(5);
    let sample = subscriber.recv_timeout(timeout)?.ok_or("no image came")?;
    let image = view::<Image>(&sample)?;
    let pixels = image.data.as_slice().ok_or("bytes are always a slice")?;
    let sum: u64 = pixels.iter().copied().map(u64::from).sum();
    println!(
        "{}x{}, mean {}",
        image.width,
        image.height,
        sum / pixels.len() as u64
    );
    Ok(())
}
