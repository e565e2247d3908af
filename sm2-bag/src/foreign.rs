//! Channels that a program of ROS 2 recorded, such as rosbag2 or the Python package `rosbags`.

use sm2_proto::limits::SCHEMA_TEXT_MAX;
use sm2_proto::schema::{ParseError, Schema};
use sm2_proto::{Name, TypeId};
use sm2_ros_idl::{DefinitionError, NameError, Set, SetError, TypeName};

use crate::ros_qos;
use crate::source::{MESSAGE_ENCODING_CDR, ROS_SCHEMA_ENCODING, Source};

/// The node of a publisher that another program recorded: such a bag has no names of nodes.
const PUBLISHER: &str = "bag";

/// The longest definition that is parsed, in bytes. It may have comments, which a schema text of SM2 does not have.
/// Many channels can have one definition.
const DEFINITION_MAX_BYTES: usize = 16 * SCHEMA_TEXT_MAX;

/// Why the messages of a channel that another program recorded are not published.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ForeignReason {
    /// The messages are not in CDR, or there is no definition of ROS 2 for them.
    #[error(
        "its messages are {message:?} with a schema in {schema:?}, not \"cdr\" with \"ros2msg\""
    )]
    Encoding {
        /// The encoding of the messages.
        message: String,
        /// The encoding of the schema; empty without a schema.
        schema: String,
    },
    /// The topic is not a name of SM2.
    #[error("SM2 allows no topic of this name")]
    Topic,
    /// The name of the type is not one of ROS 2.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The definition is not UTF-8.
    #[error("the definition of {0} is not UTF-8")]
    Text(TypeName),
    /// The definition is too long.
    #[error("the definition of {0} is longer than {DEFINITION_MAX_BYTES} bytes")]
    Long(TypeName),
    /// The definition without its comments is not a schema text of SM2 (SPEC Annex A), because it is too long or has
    /// control characters.
    #[error("the definition of {0} is not a schema text of SM2: {1}")]
    Schema(TypeName, ParseError),
    /// The definition does not parse.
    #[error("the definition of {0}, {1}")]
    Definition(TypeName, DefinitionError),
    /// A type is missing in the definition, or the types are nested without an end.
    #[error(transparent)]
    Set(#[from] SetError),
    /// The definition is not that of the hash in the metadata of the channel.
    #[error("the definition of {name} has the hash {computed}, but the channel says {stated}")]
    Hash {
        /// The type.
        name: TypeName,
        /// The hash of the definition.
        computed: String,
        /// The hash in the metadata.
        stated: String,
    },
}

/// Describes the publisher of a channel of a program of ROS 2. The hash of the type follows from its definition, and
/// the QoS from `offered_qos_profiles`.
pub(crate) fn source(channel: &mcap::Channel<'_>) -> Result<Source, ForeignReason> {
    let schema = channel.schema.as_deref();
    let schema = schema.filter(|it| {
        channel.message_encoding == MESSAGE_ENCODING_CDR && it.encoding == ROS_SCHEMA_ENCODING
    });
    let Some(schema) = schema else {
        let schema = channel.schema.as_ref();
        return Err(ForeignReason::Encoding {
            message: channel.message_encoding.clone(),
            schema: schema.map_or_else(String::new, |it| it.encoding.clone()),
        });
    };
    let topic = topic_name(&channel.topic);
    let topic = Name::new(topic).map_err(|_| ForeignReason::Topic)?;
    let name: TypeName = schema.name.parse()?;
    if schema.data.len() > DEFINITION_MAX_BYTES {
        return Err(ForeignReason::Long(name));
    }
    let Ok(definition) = str::from_utf8(&schema.data) else {
        return Err(ForeignReason::Text(name));
    };
    let set = match Set::parse(&name, definition) {
        Ok(set) => set,
        Err(error) => return Err(ForeignReason::Definition(name, error)),
    };
    let computed = set.hash(&name)?.to_string();
    // Distributions before Iron, and some programs, write no hash or another text.
    let stated = channel.metadata.get(Source::RIHS01);
    if let Some(stated) = stated.filter(|it| it.starts_with("RIHS01_") && **it != computed) {
        let stated = stated.clone();
        return Err(ForeignReason::Hash {
            name,
            computed,
            stated,
        });
    }
    let text = set.schema_text(&name)?;
    let Ok(type_name) = Name::new(&schema.name) else {
        let text = schema.name.clone();
        return Err(NameError { text }.into());
    };
    let parsed = match Schema::parse(&text) {
        Ok(parsed) => parsed,
        Err(error) => return Err(ForeignReason::Schema(name, error)),
    };
    let qos = channel.metadata.get(ros_qos::KEY);
    Ok(Source {
        topic,
        publisher: Name::new(PUBLISHER).expect("a legal name"),
        data: TypeId {
            name: type_name,
            hash: parsed.hash(),
        },
        offer: ros_qos::read(qos.map_or("", String::as_str)),
        schema: Some(text),
    })
}

/// A topic as SM2 writes it: without the slash at the start that ROS 2 has.
pub(crate) fn topic_name(topic: &str) -> &str {
    topic.strip_prefix('/').unwrap_or(topic)
}
