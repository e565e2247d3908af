//! A schema that is ready for use: checked against the name of its type, with definitions of ROS 2 parsed.

use sm2_proto::{
    Name,
    schema::{Definition, ParseError, Root, Schema},
};
use sm2_ros::Value;
use sm2_ros_idl::{
    Base, DefinitionError, Message, NameError, Primitive, Set, SetError, Shape, TypeHash, TypeName,
};

use super::{DecodeError, EncodeError, Limits};

/// Decodes and encodes the messages of one type.
#[derive(Debug)]
pub(crate) enum Codec {
    /// A type of SM2.
    Schema(Schema),
    /// A message of ROS 2 (SM2-TYP-002).
    Ros(Box<Ros>),
}

/// The definition of a message of ROS 2.
#[derive(Debug)]
pub(crate) struct Ros {
    set: Set,
    name: TypeName,
    /// Whether messages can contain byte sequences of any length, such as images.
    has_bytes: bool,
}

/// A registered definition of ROS 2 that no message can be read or written by.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum CodecError {
    /// The name of the type is not one of ROS 2.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The definition does not parse.
    #[error("the definition, {0}")]
    Definition(DefinitionError),
    /// A type is missing, or the types are nested without an end.
    #[error(transparent)]
    Set(#[from] SetError),
    /// The definition is not a schema text.
    #[error(transparent)]
    Text(#[from] ParseError),
    /// The definition is not that of the hash.
    #[error(
        "the definition has the hash {computed}, but its first line says {stated}: register the text that belongs to \
         the hash"
    )]
    Hash {
        /// The hash of the definition under the name of the type.
        computed: TypeHash,
        /// The hash in the first line.
        stated: TypeHash,
    },
}

impl Codec {
    /// Prepares the schema of the type `name`.
    ///
    /// # Errors
    ///
    /// [`CodecError`] if the schema is a definition of ROS 2 that is incomplete, or that is not the one of its hash.
    /// The hash covers the name of the type, so a right definition under another name is an error, too.
    pub(crate) fn new(name: &Name, schema: Schema) -> Result<Self, CodecError> {
        match schema.root() {
            Root::Type(_) => Ok(Self::Schema(schema)),
            Root::Definition(definition) => Ok(Self::Ros(Box::new(Ros::new(name, definition)?))),
        }
    }

    /// Decodes a message. The first `keep` elements of each list, set and map are kept, and the others counted.
    ///
    /// # Errors
    ///
    /// [`DecodeError`] if the bytes are not a message of the type.
    pub(crate) fn decode<'a>(
        &'a self,
        bytes: &'a [u8],
        keep: usize,
    ) -> Result<Value<'a>, DecodeError> {
        match self {
            Self::Schema(schema) => super::decode(schema, bytes, keep),
            Self::Ros(ros) => Ok(sm2_ros::decode(&ros.set, &ros.name, bytes, keep)?),
        }
    }

    /// Decodes a message with as many elements as programs want: all of them. Of a message of ROS 2 that can contain
    /// byte sequences, or that has too many values, each list has only the elements that a screen shows.
    ///
    /// # Errors
    ///
    /// As [`decode`](Self::decode).
    pub(crate) fn decode_all<'a>(&'a self, bytes: &'a [u8]) -> Result<Value<'a>, DecodeError> {
        let Self::Ros(ros) = self else {
            return self.decode(bytes, usize::MAX);
        };
        if ros.has_bytes {
            return self.decode(bytes, Limits::SCREEN.elements);
        }
        match self.decode(bytes, usize::MAX) {
            Err(error) if error.is_too_many() => self.decode(bytes, Limits::SCREEN.elements),
            decoded => decoded,
        }
    }

    /// Encodes JSON from the command line as a message.
    ///
    /// # Errors
    ///
    /// [`EncodeError`] with the path to the value that does not fit the type.
    pub(crate) fn encode(&self, given: &serde_json::Value) -> Result<Vec<u8>, EncodeError> {
        match self {
            Self::Schema(schema) => super::encode(schema, given),
            Self::Ros(ros) => Ok(sm2_ros::encode(&ros.set, &ros.name, given)?),
        }
    }
}

impl Ros {
    fn new(name: &Name, definition: &Definition) -> Result<Self, CodecError> {
        let name: TypeName = name.as_str().parse()?;
        let set = Set::parse(&name, definition.text()).map_err(CodecError::Definition)?;
        let (computed, stated) = (set.hash(&name)?, TypeHash(*definition.rihs01()));
        if computed != stated {
            return Err(CodecError::Hash { computed, stated });
        }
        let has_bytes = set.closure(&name)?.into_iter().any(has_bytes);
        Ok(Self {
            set,
            name,
            has_bytes,
        })
    }
}

/// Whether a field of the message is a list of bytes that is longer than lists on a screen.
fn has_bytes(message: &Message) -> bool {
    let is_long = |shape| match shape {
        Shape::One => false,
        Shape::Array(len) | Shape::Sequence(Some(len)) => len as usize > Limits::SCREEN.elements,
        Shape::Sequence(None) => true,
    };
    let is_byte = |base: &Base| {
        let bytes = [Primitive::Byte, Primitive::Char, Primitive::Uint8];
        matches!(base, Base::Primitive(primitive) if bytes.contains(primitive))
    };
    let mut fields = message.fields.iter();
    fields.any(|it| is_long(it.ty.shape) && is_byte(&it.ty.base))
}
