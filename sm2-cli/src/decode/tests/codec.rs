//! Messages of ROS 2, by the definitions in their schemas.

use std::path::Path;

use serde_json::json;
use sm2_proto::{Name, schema::Schema};
use sm2_ros_idl::{Set, TypeName};

use super::LINE;
use crate::decode::{Codec, CodecError, show};

/// The schema text of a type of the common interfaces.
fn text_of(name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sm2-ros/definitions");
    let mut set = Set::default();
    set.add_folder(&folder).unwrap();
    set.schema_text(&name.parse::<TypeName>().unwrap()).unwrap()
}

fn codec(name: &str, text: &str) -> Result<Codec, CodecError> {
    let schema = Schema::parse(text).unwrap();
    Codec::new(&Name::new(name).unwrap(), schema)
}

fn codec_of(name: &str) -> Codec {
    codec(name, &text_of(name)).unwrap()
}

const STRING: &str = "std_msgs/msg/String";
const POSE: &str = "geometry_msgs/msg/PoseStamped";
const IMAGE: &str = "sensor_msgs/msg/Image";
const SCAN: &str = "sensor_msgs/msg/LaserScan";

//= SM2-TYP-002 test
#[test]
fn a_message_is_read_by_its_definition() {
    let bytes = b"\0\x01\0\0\x06\0\0\0hello\0";
    let codec = codec_of(STRING);
    let value = codec.decode(bytes, 1).unwrap();
    assert_eq!(show(&value, &LINE), "{data: \"hello\"}");
    let json = json!({ "data": "hello" });
    assert_eq!(serde_json::to_value(&value).unwrap(), json);
    assert_eq!(codec.encode(&json).unwrap(), bytes);
}

#[test]
fn a_nested_message_survives_both_ways() {
    let codec = codec_of(POSE);
    let json = json!({
        "header": { "stamp": { "sec": 7, "nanosec": 8 }, "frame_id": "map" },
        "pose": {
            "position": { "x": 1.5, "y": -2.0, "z": 0.0 },
            "orientation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 },
        },
    });
    let bytes = codec.encode(&json).unwrap();
    let value = codec.decode_all(&bytes).unwrap();
    assert_eq!(serde_json::to_value(&value).unwrap(), json);
}

#[test]
fn long_lists_are_whole_in_json_except_bytes() {
    let scan = codec_of(SCAN);
    let bytes = scan.encode(&json!({ "ranges": vec![0.5; 360] })).unwrap();
    let json = serde_json::to_value(scan.decode_all(&bytes).unwrap()).unwrap();
    assert_eq!(json["ranges"], json!(vec![0.5; 360]));

    let image = codec_of(IMAGE);
    let bytes = image.encode(&json!({ "data": vec![9; 1000] })).unwrap();
    let json = serde_json::to_value(image.decode_all(&bytes).unwrap()).unwrap();
    let data = json["data"].as_array().unwrap();
    assert_eq!((data.len(), &data[32]), (33, &json!("… 968 more")));
}

#[test]
fn a_list_of_too_many_values_is_cut_in_json() {
    let codec = codec_of("std_msgs/msg/Int8MultiArray");
    let len = (1_u32 << 22) + 1;
    // An empty layout, and the numbers.
    let mut bytes = [[0, 1, 0, 0], [0; 4], [0; 4], len.to_le_bytes()].concat();
    bytes.resize(bytes.len() + len as usize, 0);
    let json = serde_json::to_value(codec.decode_all(&bytes).unwrap()).unwrap();
    assert_eq!(json["data"].as_array().unwrap().len(), 33);
}

#[test]
fn a_wrong_definition_is_refused() {
    let text = text_of(STRING);
    let refused = |name: &str, text: &str| codec(name, text).unwrap_err().to_string();
    // The hash covers the name of the type.
    let other_name = refused("std_msgs/msg/Text", &text);
    assert!(
        other_name.contains("but its first line says RIHS01_df668c"),
        "{other_name}"
    );
    let other_field = refused(STRING, &text.replace("string data", "string date"));
    assert!(
        other_field.contains("but its first line says"),
        "{other_field}"
    );
    let no_type = refused(STRING, &text.replace("string data", "data"));
    assert!(no_type.starts_with("the definition, line 1: "), "{no_type}");
    let missing = refused(STRING, &text.replace("string", "Other"));
    assert!(
        missing.contains("std_msgs/msg/Other, which is not defined"),
        "{missing}"
    );
    let no_name = refused("string", &text);
    assert!(
        no_name.contains("\"string\" is not the name of a type"),
        "{no_name}"
    );
}

#[test]
fn errors_name_the_place() {
    let codec = codec_of(POSE);
    let short = codec.decode(&[0, 1, 0, 0, 1], 1).unwrap_err().to_string();
    assert!(short.starts_with("header.stamp.sec: "), "{short}");
    let no_cdr = codec.decode(b"text", 1).unwrap_err().to_string();
    assert!(
        no_cdr.starts_with("message: expected the bytes"),
        "{no_cdr}"
    );
    let wrong = codec.encode(&json!({ "pose": { "position": { "x": "1" } } }));
    let wrong = wrong.unwrap_err().to_string();
    assert!(wrong.starts_with("pose.position.x: expected"), "{wrong}");
    let wrong = codec.encode(&json!(1)).unwrap_err().to_string();
    assert!(wrong.starts_with("message: expected an object"), "{wrong}");
}
