//! Messages whose types have the fields of Foxglove's own schemas, read by the types of the crate `foxglove`.

use foxglove::messages::{CompressedImage, PoseInFrame, Timestamp};
use serde::{Deserialize, Serialize};
use serde_json::json;
use sm2_foxglove::Options;
use sm2_node::{Message, Schema};
use sm2_test_support::SOON;

use crate::common::{Viewer, World};

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
struct Time {
    sec: u32,
    nsec: u32,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Message)]
#[message(name = "robot/CompressedImage", encoding = "postcard")]
struct Image {
    frame_id: String,
    timestamp: Time,
    format: String,
    data: Vec<u8>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
struct Vector {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
struct Rotation {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
struct Placement {
    position: Vector,
    orientation: Rotation,
}

/// Its name is that of no schema of Foxglove.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Message)]
#[message(name = "robot/Estimate", encoding = "json")]
struct Estimate {
    timestamp: Time,
    frame_id: String,
    pose: Placement,
}

#[test]
fn types_with_the_fields_of_foxglove_are_messages_of_foxglove() {
    let world = World::new();
    let node = world.node("camera");
    let images = node.publisher::<Image>("image").unwrap();
    let estimates = node.publisher::<Estimate>("estimate").unwrap();
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);

    let channel = viewer.channel("image");
    assert_eq!(channel.encoding, "json");
    assert_eq!(channel.schema_name, "foxglove.CompressedImage");
    assert_eq!(channel.schema_encoding.as_deref(), Some("jsonschema"));
    let schema: serde_json::Value = serde_json::from_str(&channel.schema).unwrap();
    let expected = json!({ "type": "string", "contentEncoding": "base64" });
    assert_eq!(schema["properties"]["data"], expected);
    let subscription = viewer.subscribe("image");
    images.wait_for_subscribers_timeout(1, SOON).unwrap();
    let image = Image {
        frame_id: "camera".to_owned(),
        timestamp: Time { sec: 7, nsec: 8 },
        format: "jpeg".to_owned(),
        data: vec![0, 255, 16],
    };
    images.publish(&image).unwrap();
    let message = viewer.message(subscription);
    let read: CompressedImage = serde_json::from_slice(&message.data).unwrap();
    assert_eq!(read.timestamp, Some(Timestamp::new(7, 8)));
    assert_eq!((&*read.frame_id, &*read.format), ("camera", "jpeg"));
    assert_eq!(*read.data, [0, 255, 16]);

    let channel = viewer.channel("estimate");
    assert_eq!(channel.schema_name, "foxglove.PoseInFrame");
    let subscription = viewer.subscribe("estimate");
    estimates.wait_for_subscribers_timeout(1, SOON).unwrap();
    let mut estimate = Estimate::default();
    estimate.pose.position.y = -1.5;
    estimates.publish(&estimate).unwrap();
    let message = viewer.message(subscription);
    let read: PoseInFrame = serde_json::from_slice(&message.data).unwrap();
    assert_eq!(read.pose.unwrap().position.unwrap().y, -1.5);
}
