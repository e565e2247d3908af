//! Nodes that exchange ROS 2's types over topics and services.

use serde_json::json;
use sm2_manager::{Background, Options};
use sm2_node::{Message, Node, PublishError, RecvError, StoreError};
use sm2_ros::nav_msgs::srv::GetMap;
use sm2_ros::sensor_msgs::msg::Image;
use sm2_ros::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
use sm2_ros::{Service, Type, encode, view};
use sm2_ros_idl::Set;
use sm2_test_support::SOON;
use tempfile::TempDir;

/// Two nodes of one domain.
struct Pair {
    nodes: [Node; 2],
    _manager: Background,
    _folder: TempDir,
}

fn pair(ring: bool) -> Pair {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("domain.sock");
    let manager = Background::start(&socket, Options::default()).unwrap();
    let nodes = ["camera", "viewer"].map(|name| {
        let builder = Node::builder(name).socket(&socket).ring_lane(ring);
        builder.connect().unwrap()
    });
    Pair {
        nodes,
        _manager: manager,
        _folder: folder,
    }
}

fn image(len: usize) -> Image {
    let mut image = Image {
        height: 2,
        width: u32::try_from(len / 2).unwrap(),
        encoding: "mono8".to_owned(),
        step: u32::try_from(len / 2).unwrap(),
        data: (0..len).map(|at| (at % 251) as u8).collect(),
        ..Image::default()
    };
    image.header.frame_id = "front".to_owned();
    image
}

/// The bytes that the codec without Rust types makes of the same image.
fn dynamic(image: &Image) -> Vec<u8> {
    let mut set = Set::default();
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/definitions");
    set.add_folder(folder.as_ref()).unwrap();
    let value = json!({
        "header": {"frame_id": image.header.frame_id},
        "height": image.height,
        "width": image.width,
        "encoding": image.encoding,
        "step": image.step,
        "data": image.data,
    });
    encode(&set, &Image::TYPE_NAME.parse().unwrap(), &value).unwrap()
}

/// Short and long messages, inline, in slots and in sealed files: the subscriber gets the image, and a subscriber of
/// bytes the same bytes as from the codec without Rust types.
#[test]
fn images_arrive_in_every_form() {
    for (ring, sealed) in [(true, false), (false, false), (false, true)] {
        let Pair { nodes, .. } = &pair(ring);
        let publisher = nodes[0].publisher::<Image>("image").unwrap();
        let subscriber = nodes[1].subscriber_builder::<Image>("image").sealed(sealed);
        let subscriber = subscriber.declare().unwrap();
        let bytes = nodes[1].subscriber_builder::<[u8]>("image").any_type();
        let bytes = bytes.declare().unwrap();
        publisher.wait_for_subscribers_timeout(2, SOON).unwrap();
        for len in [0, 100, 20_000, 50_000, 300_000] {
            let sent = image(len);
            assert_eq!(publisher.publish(&sent).unwrap().links, 2);
            let received = subscriber.recv_timeout(SOON).unwrap().expect("the image");
            assert!(
                *received == sent,
                "ring {ring}, sealed {sealed}, {len} bytes"
            );
            let received = bytes.recv_timeout(SOON).unwrap().expect("its bytes");
            assert!(*received == dynamic(&sent), "{len} bytes");
            assert_eq!(received.type_id(), Some(&Image::type_id()));
        }
        // Many of them, and one that must not wait.
        let sent = [image(10), image(60_000)];
        assert_eq!(publisher.publish_all(&sent).unwrap().links, 2);
        assert!(publisher.try_publish(&sent[1]).unwrap().is_some());
        for sent in [&sent[0], &sent[1], &sent[1]] {
            let received = subscriber.recv_timeout(SOON).unwrap().expect("the image");
            assert!(*received == *sent);
        }
    }
}

/// A subscriber for bytes of a type has the numbers where the publisher put them.
#[test]
fn images_are_read_in_place() {
    for ring in [true, false] {
        let Pair { nodes, .. } = &pair(ring);
        let publisher = nodes[0].publisher::<Image>("image").unwrap();
        let subscriber = nodes[1].subscriber_builder::<[u8]>("image");
        let subscriber = subscriber.type_id(Image::type_id()).declare().unwrap();
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        for len in [0, 100, 300_000] {
            let sent = image(len);
            publisher.publish(&sent).unwrap();
            let sample = subscriber.recv_timeout(SOON).unwrap().expect("the image");
            let image = view::<Image>(&sample).unwrap();
            assert_eq!(image.header.frame_id, "front");
            assert_eq!(
                (image.width, image.encoding.as_str()),
                (sent.width, "mono8")
            );
            let data = image.data.as_slice().unwrap();
            assert!(data == sent.data, "{len} bytes");
            let places = [data.as_ptr_range(), sample.as_ptr_range()];
            assert!(data.is_empty() || places[0].start > places[1].start);
            assert!(places[0].end <= places[1].end || data.is_empty());
        }
    }
}

#[test]
fn services_carry_requests_and_replies() {
    let Pair { nodes, .. } = &pair(true);
    let server = SetBool::server(&nodes[0], "light").unwrap();
    let maps = GetMap::server(&nodes[0], "map").unwrap();
    let client = SetBool::client(&nodes[1], "light").unwrap();
    let map_client = GetMap::client(&nodes[1], "map").unwrap();
    client.wait_for_servers_timeout(1, SOON).unwrap();
    map_client.wait_for_servers_timeout(1, SOON).unwrap();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let request = server.recv_timeout(SOON).unwrap().expect("a request");
            let message = format!("set to {}", request.data);
            let reply = SetBoolResponse {
                success: true,
                message,
            };
            request.reply(&reply).unwrap();
            // A reply that is encoded where it is stored.
            let request = maps.recv_timeout(SOON).unwrap().expect("a request");
            let mut reply = <GetMap as Service>::Response::default();
            reply.map.data = vec![-1; 100_000];
            request.reply(&reply).unwrap();
        });
        let reply = client.call_timeout(&SetBoolRequest { data: true }, SOON);
        let reply = reply.unwrap();
        assert!(reply.success);
        assert_eq!(reply.message, "set to true");
        let reply = map_client.call_timeout(&<GetMap as Service>::Request::default(), SOON);
        assert!(reply.unwrap().map.data == vec![-1; 100_000]);
    });
}

/// A publisher that sends other bytes than it declared is an error at the subscriber, and not more.
#[test]
fn bytes_that_are_no_image_are_an_error() {
    for ring in [true, false] {
        let Pair { nodes, .. } = &pair(ring);
        let publisher = nodes[0].publisher_builder::<[u8]>("image");
        let publisher = publisher.type_id(Image::type_id()).declare().unwrap();
        let subscriber = nodes[1].subscriber::<Image>("image").unwrap();
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        for len in [3, 30_000] {
            let mut bytes = vec![0xff; len];
            bytes[..2].copy_from_slice(&[0, 1]);
            publisher.publish(&*bytes).unwrap();
            match subscriber.recv_timeout(SOON) {
                Err(RecvError::Payload { reason, .. }) => {
                    assert!(
                        reason.to_string().contains("sensor_msgs/msg/Image"),
                        "{reason}"
                    );
                }
                other => panic!("{other:?}"),
            }
        }
        publisher.publish(&*dynamic(&image(5))).unwrap();
        assert!(*subscriber.recv_timeout(SOON).unwrap().expect("the image") == image(5));
    }
}

/// A value that its definition does not allow is refused by the publisher.
#[test]
fn a_value_without_an_encoding_is_not_published() {
    let Pair { nodes, .. } = &pair(true);
    let publisher = nodes[0].publisher("shape").unwrap();
    let solid = sm2_ros::shape_msgs::msg::SolidPrimitive {
        dimensions: vec![1.0; 4],
        ..Default::default()
    };
    match publisher.publish(&solid) {
        Err(PublishError::Store(StoreError::Encode(error))) => assert_eq!(
            error.reason,
            "dimensions: 4 elements, where the definition allows 3"
        ),
        other => panic!("{other:?}"),
    }
}
