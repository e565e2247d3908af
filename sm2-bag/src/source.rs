//! The publisher of a topic, as a bag describes it.

use std::collections::BTreeMap;

use sm2_proto::schema::Schema;
use sm2_proto::{Name, OfferedQos, TypeId};

/// One publisher of one topic: a channel of the bag.
///
/// The metadata of the channel have the name of the type (`sm2.type`), its hash as 16 hexadecimal digits
/// (`sm2.type_hash`), the publisher's node (`sm2.publisher`) and the QoS as JSON (`sm2.qos`; times in nanoseconds).
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Source {
    /// The topic.
    pub topic: Name,
    /// The publisher's node.
    pub publisher: Name,
    /// The type of the messages.
    pub data: TypeId,
    /// The QoS that the publisher offers.
    pub offer: OfferedQos,
    /// The schema text of the type, if a node had registered one.
    pub schema: Option<String>,
}

/// The encoding of a schema record with a schema text of SM2.
const SCHEMA_ENCODING: &str = "sm2";

impl Source {
    const TYPE: &str = "sm2.type";
    const HASH: &str = "sm2.type_hash";
    const PUBLISHER: &str = "sm2.publisher";
    const QOS: &str = "sm2.qos";

    /// The encoding of the messages.
    pub(crate) fn message_encoding(&self) -> String {
        let schema = self.schema.as_ref().and_then(|it| Schema::parse(it).ok());
        schema.map_or_else(|| "bytes".to_owned(), |it| it.encoding().name().to_owned())
    }

    /// The encoding and the content of the schema record. Both are empty without a schema text.
    pub(crate) fn schema_record(&self) -> (&'static str, &[u8]) {
        match &self.schema {
            Some(text) => (SCHEMA_ENCODING, text.as_bytes()),
            None => ("", &[]),
        }
    }

    pub(crate) fn metadata(&self) -> BTreeMap<String, String> {
        let qos = serde_json::to_string(&self.offer).expect("numbers and flags");
        [
            (Self::TYPE, self.data.name.to_string()),
            (Self::HASH, format!("{:016x}", self.data.hash)),
            (Self::PUBLISHER, self.publisher.to_string()),
            (Self::QOS, qos),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into()
    }

    /// Reads the channel of a bag. `None` if another program than SM2 made it.
    pub(crate) fn of_channel(channel: &mcap::Channel<'_>) -> Option<Self> {
        let text = |key| channel.metadata.get(key);
        let name = |key| Name::new(text(key)?).ok();
        let schema = channel.schema.as_deref();
        let schema = schema.filter(|it| it.encoding == SCHEMA_ENCODING);
        Some(Self {
            topic: Name::new(&channel.topic).ok()?,
            publisher: name(Self::PUBLISHER)?,
            data: TypeId {
                name: name(Self::TYPE)?,
                hash: u64::from_str_radix(text(Self::HASH)?, 16).ok()?,
            },
            offer: serde_json::from_str(text(Self::QOS)?).ok()?,
            schema: schema.and_then(|it| String::from_utf8(it.data.to_vec()).ok()),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use sm2_proto::Period;

    use super::*;

    fn source(schema: Option<&str>) -> Source {
        let name = |text| Name::new(text).unwrap();
        Source {
            topic: name("image"),
            publisher: name("camera/front"),
            data: TypeId {
                name: name("text"),
                hash: 0x00ff_0000_0000_0001,
            },
            offer: OfferedQos {
                depth: 8,
                reliable: true,
                latched: 1,
                sealed: false,
                deadline: Period(5),
                lifespan: Period::NONE,
                lease: Period(7),
            },
            schema: schema.map(str::to_owned),
        }
    }

    fn channel(source: &Source) -> mcap::Channel<'_> {
        let (encoding, data) = source.schema_record();
        mcap::Channel {
            id: 1,
            topic: source.topic.to_string(),
            schema: Some(Arc::new(mcap::Schema {
                id: 1,
                name: source.data.name.to_string(),
                encoding: encoding.to_owned(),
                data: data.into(),
            })),
            message_encoding: source.message_encoding(),
            metadata: source.metadata(),
        }
    }

    #[test]
    fn a_channel_has_the_whole_publisher() {
        for (schema, encoding) in [(Some("plain:string"), "plain"), (None, "bytes")] {
            let source = source(schema);
            let channel = channel(&source);
            assert_eq!(channel.message_encoding, encoding);
            assert_eq!(Source::of_channel(&channel), Some(source));
        }
    }

    #[test]
    fn a_channel_of_another_program_has_no_publisher() {
        let source = source(None);
        for key in [Source::TYPE, Source::HASH, Source::PUBLISHER, Source::QOS] {
            let mut channel = channel(&source);
            channel.metadata.insert(key.to_owned(), "//".to_owned());
            assert_eq!(Source::of_channel(&channel), None, "{key}");
            channel.metadata.remove(key);
            assert_eq!(Source::of_channel(&channel), None, "{key}");
        }
    }
}
