//! The detector of the example `ros2`, moved to SM2. See the book's chapter "Moving a pipeline".

use std::error::Error;

use sm2_node::{Message, Node};
use sm2_ros::geometry_msgs::msg::{Point, PointStamped};
use sm2_ros::sensor_msgs::msg::Image;
use sm2_ros::view;

fn main() -> Result<(), Box<dyn Error>> {
    let node = Node::new("detector")?;
    // The bytes of the images: their pixels are read where the publisher has put them.
    let images = node.subscriber_builder::<[u8]>("camera/image");
    let images = images.type_id(Image::type_id()).declare()?;
    if let Some(definition) = Image::schema() {
        node.register_schema(Image::type_id(), &definition)?;
    }
    let places = node.publisher::<PointStamped>("detections")?;
    loop {
        let sample = images.recv()?;
        let image = view::<Image>(&sample)?;
        let pixels = image.data.as_slice().ok_or("bytes are always a slice")?;
        let brightest = pixels.iter().enumerate().max_by_key(|it| it.1);
        let Some((at, _)) = brightest else { continue };
        let at = u32::try_from(at)?;
        places.publish(&PointStamped {
            header: image.header,
            point: Point {
                x: f64::from(at % image.step),
                y: f64::from(at / image.step),
                z: 0.0,
            },
        })?;
    }
}
