use foxglove::messages as its;
use foxglove::{Encode, Schema as Described};
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type as ProtoType};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorSet};
use sm2_proto::schema::{Root, Schema};

use super::*;

/// All schemas of the crate `foxglove` that are whole messages.
const DESCRIBED: [fn() -> Option<Described>; 24] = [
    its::CameraCalibration::get_schema,
    its::CompressedAudio::get_schema,
    its::CompressedImage::get_schema,
    its::CompressedPointCloud::get_schema,
    its::CompressedVideo::get_schema,
    its::FrameTransform::get_schema,
    its::FrameTransforms::get_schema,
    its::GeoJson::get_schema,
    its::Grid::get_schema,
    its::ImageAnnotations::get_schema,
    its::JointStates::get_schema,
    its::LaserScan::get_schema,
    its::LocationFix::get_schema,
    its::LocationFixes::get_schema,
    its::Log::get_schema,
    its::Odometry::get_schema,
    its::Point3InFrame::get_schema,
    its::PointCloud::get_schema,
    its::PoseInFrame::get_schema,
    its::PosesInFrame::get_schema,
    its::RawAudio::get_schema,
    its::RawImage::get_schema,
    its::SceneUpdate::get_schema,
    its::VoxelGrid::get_schema,
];

/// A message of a set, by a name such as `foxglove.Pose`.
fn message<'a>(set: &'a FileDescriptorSet, name: &str) -> &'a DescriptorProto {
    let (package, name) = name.rsplit_once('.').unwrap();
    let files = set.file.iter().filter(|it| it.package() == package);
    let mut messages = files.flat_map(|it| &it.message_type);
    messages.find(|it| it.name() == name).unwrap()
}

/// Compares the kind of a value with the type of one value of a field in Protobuf.
fn compare(set: &FileDescriptorSet, kind: &Kind, field: &FieldDescriptorProto, place: &str) {
    let is_equal = match (field.r#type(), kind) {
        (ProtoType::Double, Kind::Number)
        | (ProtoType::Fixed32 | ProtoType::Enum, Kind::Integer)
        | (ProtoType::Bool, Kind::Boolean)
        | (ProtoType::String, Kind::Text)
        | (ProtoType::Bytes, Kind::Bytes) => true,
        (ProtoType::Message, Kind::Object(fields)) => match field.type_name() {
            ".google.protobuf.Timestamp" | ".google.protobuf.Duration" => {
                fields.iter().map(|it| it.name).eq(["sec", "nsec"])
            }
            name => {
                let described = message(set, name.trim_start_matches('.'));
                compare_fields(set, fields, described, place);
                true
            }
        },
        _ => false,
    };
    assert!(is_equal, "{place}: {kind:?} is not {field:?}");
}

fn compare_fields(
    set: &FileDescriptorSet,
    fields: &[Field],
    described: &DescriptorProto,
    place: &str,
) {
    let names = fields.iter().map(|it| it.name);
    let expected = described.field.iter().map(FieldDescriptorProto::name);
    assert!(names.eq(expected), "{place}: {fields:?}");
    for (field, described) in fields.iter().zip(&described.field) {
        let place = format!("{place}.{}", field.name);
        match (&field.kind, described.label()) {
            (Kind::List { element, .. }, Label::Repeated) => {
                compare(set, element, described, &place);
            }
            (kind, label) => {
                assert_ne!(label, Label::Repeated, "{place}");
                compare(set, kind, described, &place);
            }
        }
        assert!(
            field.is_optional || !described.proto3_optional(),
            "{place} is optional"
        );
    }
}

#[test]
fn the_table_has_the_fields_of_the_crate() {
    let described = DESCRIBED.map(|schema| schema().unwrap());
    let names = SCHEMAS.iter().map(|it| it.name);
    assert!(names.eq(described.iter().map(|it| it.name.as_str())));
    for (schema, described) in SCHEMAS.iter().zip(&described) {
        let Kind::Object(fields) = &schema.root else {
            panic!("{schema:?}");
        };
        let set = FileDescriptorSet::decode(&*described.data).unwrap();
        compare_fields(&set, fields, message(&set, schema.name), schema.name);
    }
}

/// The name of the schema of a type with a name and these fields.
fn of(name: &str, fields: &str) -> Option<&'static str> {
    let schema = Schema::parse(&format!("postcard:struct{{{fields}}}")).unwrap();
    let Root::Type(ty) = schema.root() else {
        panic!("a type of ROS 2");
    };
    FoxgloveSchema::of(&Name::new(name).unwrap(), ty).map(|it| it.name)
}

const TIME: &str = "struct{sec:u32,nsec:u32,}";
const VECTOR: &str = "struct{x:f64,y:f64,z:f64,}";

#[test]
fn a_type_with_the_same_fields_has_the_schema() {
    let point = format!("timestamp:{TIME},frame_id:string,point:{VECTOR},");
    let expected = Some("foxglove.Point3InFrame");
    assert_eq!(of("lidar/Corner", &point), expected);
    let other_order = format!("frame_id:string,point:{VECTOR},timestamp:{TIME},");
    assert_eq!(of("lidar/Corner", &other_order), expected);
    let other_integers = point.replace("u32", "i64").replace("f64", "f32");
    assert_eq!(of("lidar/Corner", &other_integers), expected);
    for different in [
        point.replace("frame_id", "frame"),
        point.replace("frame_id:string,", ""),
        format!("{point}id:u8,"),
        point.replace("frame_id:string", "frame_id:u8"),
        point.replace("frame_id:string", "frame_id:option[string]"),
        point.replace(TIME, "u64"),
        point.replace("z:f64,", ""),
        point.replace("z:f64", "z:u32"),
    ] {
        assert_eq!(of("Point3InFrame", &different), None, "{different}");
    }
}

#[test]
fn optional_fields_may_be_missing_and_arrays_have_their_length() {
    let fix = format!(
        "timestamp:{TIME},frame_id:string,latitude:f64,longitude:f64,altitude:f64,\
         position_covariance:array[f64;0000000000000009],position_covariance_type:u8,"
    );
    let expected = Some("foxglove.LocationFix");
    assert_eq!(of("Gps", &fix), expected);
    assert_eq!(
        of(
            "Gps",
            &fix.replace("array[f64;0000000000000009]", "list[f64]")
        ),
        expected
    );
    assert_eq!(of("Gps", &fix.replace("09]", "08]")), None);
    assert_eq!(of("Gps", &format!("{fix}heading:option[f64],")), expected);
    assert_eq!(of("Gps", &format!("{fix}heading:f64,")), expected);
    assert_eq!(of("Gps", &format!("{fix}heading:string,")), None);
}

#[test]
fn the_name_decides_between_equal_schemas() {
    let fields = format!("timestamp:{TIME},frame_id:string,data:list[u8],format:string,");
    let image = Some("foxglove.CompressedImage");
    assert_eq!(of("CompressedImage", &fields), image);
    assert_eq!(of("camera/CompressedImage", &fields), image);
    assert_eq!(
        of("CompressedVideo", &fields),
        Some("foxglove.CompressedVideo")
    );
    assert_eq!(of("Frame", &fields), None);
}

#[test]
fn values_without_a_value_are_no_fields_and_bytes_are_in_base64() {
    let joints = SCHEMAS.iter().find(|it| it.name == "foxglove.JointStates");
    let joints = joints.unwrap();
    let mut message = json!({ "joints": [{ "name": "a", "position": 1.5, "effort": null }] });
    joints.to_viewer(&mut message);
    let expected = json!({ "joints": [{ "name": "a", "position": 1.5 }] });
    assert_eq!(message, expected);

    let scene = SCHEMAS.iter().find(|it| it.name == "foxglove.SceneUpdate");
    let scene = scene.unwrap();
    let domain = json!({ "entities": [{ "models": [{ "data": [0, 255, 16] }] }] });
    let mut message = domain.clone();
    scene.to_viewer(&mut message);
    let expected = json!({ "entities": [{ "models": [{ "data": "AP8Q" }] }] });
    assert_eq!(message, expected);
    scene.to_domain(&mut message).unwrap();
    assert_eq!(message, domain);
}
