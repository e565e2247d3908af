//! Messages of any type with a schema as JSON, for programs that do not know the types.

use std::error::Error;

use sm2_proto::{Name, schema::Schema};

use crate::decode::Codec;

/// The reason why a message or a schema cannot be used, for people.
type Unusable = Box<dyn Error + Send + Sync>;

/// Converts the messages of one type to JSON and back, in the form of `sm2 topic echo --json` and `sm2 topic pub`.
#[derive(Debug)]
pub struct Transcoder(Codec);

impl Transcoder {
    /// Prepares the schema of the type `name`.
    ///
    /// # Errors
    ///
    /// The schema is a wrong definition of a type of ROS 2.
    pub fn new(name: &Name, schema: Schema) -> Result<Self, Unusable> {
        Ok(Self(Codec::new(name, schema)?))
    }

    /// The JSON of a message.
    ///
    /// # Errors
    ///
    /// The bytes are not a message of the type.
    pub fn to_json(&self, message: &[u8]) -> Result<Vec<u8>, Unusable> {
        Ok(serde_json::to_vec(&self.0.decode_all(message)?)?)
    }

    /// The message of a value in JSON.
    ///
    /// # Errors
    ///
    /// The value does not fit the type.
    pub fn to_message(&self, value: &serde_json::Value) -> Result<Vec<u8>, Unusable> {
        Ok(self.0.encode(value)?)
    }
}
