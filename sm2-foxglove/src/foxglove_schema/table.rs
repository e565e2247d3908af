//! The fields of the schemas, as in the crate `foxglove`.
//!
//! Source: <https://docs.foxglove.dev/docs/visualization/message-schemas/introduction>. A test compares the table with
//! the crate. Foxglove added the optional fields to schemas that existed before, so older types do not have them.

use super::kind::Kind::{Boolean, Bytes, Integer, List, Number, Object, Text};
use super::kind::{Field, FoxgloveSchema, Kind};

const fn field(name: &'static str, kind: Kind) -> Field {
    Field {
        name,
        kind,
        is_optional: false,
    }
}

const fn optional(name: &'static str, kind: Kind) -> Field {
    Field {
        name,
        kind,
        is_optional: true,
    }
}

const fn list(element: &'static Kind) -> Kind {
    List { element, len: None }
}

/// A list of this many numbers.
const fn numbers(len: u64) -> Kind {
    List {
        element: &Number,
        len: Some(len),
    }
}

const fn schema(name: &'static str, fields: &'static [Field]) -> FoxgloveSchema {
    FoxgloveSchema {
        name,
        root: Object(fields),
    }
}

/// A time or a duration.
const TIME: Kind = Object(&[field("sec", Integer), field("nsec", Integer)]);
const TIMESTAMP: Field = field("timestamp", TIME);
const FRAME_ID: Field = field("frame_id", Text);

const VECTOR2: Kind = Object(&[field("x", Number), field("y", Number)]);
const VECTOR3: Kind = Object(&[field("x", Number), field("y", Number), field("z", Number)]);
const QUATERNION: Kind = Object(&[
    field("x", Number),
    field("y", Number),
    field("z", Number),
    field("w", Number),
]);
const COLOR: Kind = Object(&[
    field("r", Number),
    field("g", Number),
    field("b", Number),
    field("a", Number),
]);
const POSE: Kind = Object(&[field("position", VECTOR3), field("orientation", QUATERNION)]);
const METADATA: Kind = list(&Object(&[field("key", Text), field("value", Text)]));
const PACKED_ELEMENTS: Kind = list(&Object(&[
    field("name", Text),
    field("offset", Integer),
    field("type", Integer),
]));

const FRAME_TRANSFORM: &[Field] = &[
    TIMESTAMP,
    field("parent_frame_id", Text),
    field("child_frame_id", Text),
    field("translation", VECTOR3),
    field("rotation", QUATERNION),
];
const LOCATION_FIX: &[Field] = &[
    TIMESTAMP,
    FRAME_ID,
    field("latitude", Number),
    field("longitude", Number),
    field("altitude", Number),
    field("position_covariance", numbers(9)),
    field("position_covariance_type", Integer),
    optional("heading", Number),
    optional("velocity", VECTOR3),
    optional("color", COLOR),
    optional("metadata", METADATA),
];
const JOINT_STATE: Kind = Object(&[
    field("name", Text),
    optional("position", Number),
    optional("velocity", Number),
    optional("acceleration", Number),
    optional("effort", Number),
]);

const CIRCLE_ANNOTATION: Kind = Object(&[
    TIMESTAMP,
    field("position", VECTOR2),
    field("diameter", Number),
    field("thickness", Number),
    field("fill_color", COLOR),
    field("outline_color", COLOR),
    optional("metadata", METADATA),
]);
const POINTS_ANNOTATION: Kind = Object(&[
    TIMESTAMP,
    field("type", Integer),
    field("points", list(&VECTOR2)),
    field("outline_color", COLOR),
    field("outline_colors", list(&COLOR)),
    field("fill_color", COLOR),
    field("thickness", Number),
    optional("metadata", METADATA),
]);
const TEXT_ANNOTATION: Kind = Object(&[
    TIMESTAMP,
    field("position", VECTOR2),
    field("text", Text),
    field("font_size", Number),
    field("text_color", COLOR),
    field("background_color", COLOR),
    optional("metadata", METADATA),
]);

const SCENE_ENTITY_DELETION: Kind = Object(&[TIMESTAMP, field("type", Integer), field("id", Text)]);
const SCENE_ENTITY: Kind = Object(&[
    TIMESTAMP,
    FRAME_ID,
    field("id", Text),
    field("lifetime", TIME),
    field("frame_locked", Boolean),
    field("metadata", METADATA),
    field("arrows", list(&ARROW)),
    field("cubes", list(&SIZED)),
    field("spheres", list(&SIZED)),
    field("cylinders", list(&CYLINDER)),
    field("lines", list(&LINE)),
    field("triangles", list(&TRIANGLE_LIST)),
    field("texts", list(&TEXT)),
    field("models", list(&MODEL)),
]);
const ARROW: Kind = Object(&[
    field("pose", POSE),
    field("shaft_length", Number),
    field("shaft_diameter", Number),
    field("head_length", Number),
    field("head_diameter", Number),
    field("color", COLOR),
]);
/// A cube or a sphere.
const SIZED: Kind = Object(&[
    field("pose", POSE),
    field("size", VECTOR3),
    field("color", COLOR),
]);
const CYLINDER: Kind = Object(&[
    field("pose", POSE),
    field("size", VECTOR3),
    field("bottom_scale", Number),
    field("top_scale", Number),
    field("color", COLOR),
]);
const LINE: Kind = Object(&[
    field("type", Integer),
    field("pose", POSE),
    field("thickness", Number),
    field("scale_invariant", Boolean),
    field("points", list(&VECTOR3)),
    field("color", COLOR),
    field("colors", list(&COLOR)),
    field("indices", list(&Integer)),
]);
const TRIANGLE_LIST: Kind = Object(&[
    field("pose", POSE),
    field("points", list(&VECTOR3)),
    field("color", COLOR),
    field("colors", list(&COLOR)),
    field("indices", list(&Integer)),
]);
const TEXT: Kind = Object(&[
    field("pose", POSE),
    field("billboard", Boolean),
    field("font_size", Number),
    field("scale_invariant", Boolean),
    field("color", COLOR),
    field("text", Text),
]);
const MODEL: Kind = Object(&[
    field("pose", POSE),
    field("scale", VECTOR3),
    field("color", COLOR),
    field("override_color", Boolean),
    field("url", Text),
    field("media_type", Text),
    field("data", Bytes),
]);

/// The schemas that are whole messages.
pub(super) const SCHEMAS: &[FoxgloveSchema] = &[
    schema(
        "foxglove.CameraCalibration",
        &[
            TIMESTAMP,
            FRAME_ID,
            field("width", Integer),
            field("height", Integer),
            field("distortion_model", Text),
            field("D", list(&Number)),
            field("K", numbers(9)),
            field("R", numbers(9)),
            field("P", numbers(12)),
        ],
    ),
    schema(
        "foxglove.CompressedAudio",
        &[TIMESTAMP, field("data", Bytes), field("format", Text)],
    ),
    schema(
        "foxglove.CompressedImage",
        &[
            TIMESTAMP,
            FRAME_ID,
            field("data", Bytes),
            field("format", Text),
        ],
    ),
    schema(
        "foxglove.CompressedPointCloud",
        &[
            TIMESTAMP,
            FRAME_ID,
            field("pose", POSE),
            field("data", Bytes),
            field("format", Text),
        ],
    ),
    schema(
        "foxglove.CompressedVideo",
        &[
            TIMESTAMP,
            FRAME_ID,
            field("data", Bytes),
            field("format", Text),
        ],
    ),
    schema("foxglove.FrameTransform", FRAME_TRANSFORM),
    schema(
        "foxglove.FrameTransforms",
        &[field("transforms", list(&Object(FRAME_TRANSFORM)))],
    ),
    schema("foxglove.GeoJSON", &[field("geojson", Text)]),
    schema(
        "foxglove.Grid",
        &[
            TIMESTAMP,
            FRAME_ID,
            field("pose", POSE),
            field("column_count", Integer),
            field("cell_size", VECTOR2),
            field("row_stride", Integer),
            field("cell_stride", Integer),
            field("fields", PACKED_ELEMENTS),
            field("data", Bytes),
        ],
    ),
    schema(
        "foxglove.ImageAnnotations",
        &[
            optional("timestamp", TIME),
            field("circles", list(&CIRCLE_ANNOTATION)),
            field("points", list(&POINTS_ANNOTATION)),
            field("texts", list(&TEXT_ANNOTATION)),
            optional("metadata", METADATA),
        ],
    ),
    schema(
        "foxglove.JointStates",
        &[TIMESTAMP, field("joints", list(&JOINT_STATE))],
    ),
    schema(
        "foxglove.LaserScan",
        &[
            TIMESTAMP,
            FRAME_ID,
            field("pose", POSE),
            field("start_angle", Number),
            field("end_angle", Number),
            field("ranges", list(&Number)),
            field("intensities", list(&Number)),
        ],
    ),
    schema("foxglove.LocationFix", LOCATION_FIX),
    schema(
        "foxglove.LocationFixes",
        &[field("fixes", list(&Object(LOCATION_FIX)))],
    ),
    schema(
        "foxglove.Log",
        &[
            TIMESTAMP,
            field("level", Integer),
            field("message", Text),
            field("name", Text),
            field("file", Text),
            field("line", Integer),
        ],
    ),
    schema(
        "foxglove.Odometry",
        &[
            TIMESTAMP,
            FRAME_ID,
            field("body_frame_id", Text),
            field("pose", POSE),
            optional("linear_velocity", VECTOR3),
            optional("angular_velocity", VECTOR3),
            optional("pose_covariance", numbers(36)),
            optional("velocity_covariance", numbers(36)),
            optional("metadata", METADATA),
        ],
    ),
    schema(
        "foxglove.Point3InFrame",
        &[TIMESTAMP, FRAME_ID, field("point", VECTOR3)],
    ),
    schema(
        "foxglove.PointCloud",
        &[
            TIMESTAMP,
            FRAME_ID,
            field("pose", POSE),
            field("point_stride", Integer),
            field("fields", PACKED_ELEMENTS),
            field("data", Bytes),
        ],
    ),
    schema(
        "foxglove.PoseInFrame",
        &[TIMESTAMP, FRAME_ID, field("pose", POSE)],
    ),
    schema(
        "foxglove.PosesInFrame",
        &[TIMESTAMP, FRAME_ID, field("poses", list(&POSE))],
    ),
    schema(
        "foxglove.RawAudio",
        &[
            TIMESTAMP,
            field("data", Bytes),
            field("format", Text),
            field("sample_rate", Integer),
            field("number_of_channels", Integer),
        ],
    ),
    schema(
        "foxglove.RawImage",
        &[
            TIMESTAMP,
            FRAME_ID,
            field("width", Integer),
            field("height", Integer),
            field("encoding", Text),
            field("step", Integer),
            field("data", Bytes),
        ],
    ),
    schema(
        "foxglove.SceneUpdate",
        &[
            field("deletions", list(&SCENE_ENTITY_DELETION)),
            field("entities", list(&SCENE_ENTITY)),
        ],
    ),
    schema(
        "foxglove.VoxelGrid",
        &[
            TIMESTAMP,
            FRAME_ID,
            field("pose", POSE),
            field("row_count", Integer),
            field("column_count", Integer),
            field("cell_size", VECTOR3),
            field("slice_stride", Integer),
            field("row_stride", Integer),
            field("cell_stride", Integer),
            field("fields", PACKED_ELEMENTS),
            field("data", Bytes),
        ],
    ),
];
