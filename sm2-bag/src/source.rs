//! The publisher of a topic, as a bag describes it.

use std::collections::BTreeMap;

use sm2_proto::schema::{Root, Schema};
use sm2_proto::{Name, OfferedQos, TypeId};

use crate::report::TopicType;
use crate::ros_qos;

/// One publisher of one topic: a channel of the bag.
///
/// The metadata of the channel have the name of the type (`sm2.type`), its hash as 16 hexadecimal digits
/// (`sm2.type_hash`), the publisher's node (`sm2.publisher`) and the QoS as JSON (`sm2.qos`; times in nanoseconds).
/// A type of ROS 2 also has its RIHS01 hash there, and the QoS in the form of rosbag2 (`topic_type_hash`,
/// `offered_qos_profiles`).
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

/// The QoS in the bag of a publisher that is gone before its first message was taken.
pub(crate) const UNKNOWN_OFFER: OfferedQos = OfferedQos::new(1);

/// The encoding of a schema record with a schema text of SM2.
const SCHEMA_ENCODING: &str = "sm2";
/// The encoding of a schema record with a definition of ROS 2.
pub(crate) const ROS_SCHEMA_ENCODING: &str = "ros2msg";
/// The encoding of messages of ROS 2.
pub(crate) const MESSAGE_ENCODING_CDR: &str = "cdr";

/// The hash of a type as 16 hexadecimal digits: not every reader of JSON supports integers of 64 bits.
fn hash_text(data: &TypeId) -> String {
    format!("{:016x}", data.hash)
}

impl Source {
    const TYPE: &str = "sm2.type";
    const HASH: &str = "sm2.type_hash";
    const PUBLISHER: &str = "sm2.publisher";
    const QOS: &str = "sm2.qos";
    pub(crate) const RIHS01: &str = "topic_type_hash";

    /// Whether the type is one of ROS 2.
    pub(crate) fn is_ros(&self) -> bool {
        self.definition().is_some()
    }

    /// The encoding of the messages.
    pub(crate) fn message_encoding(&self) -> String {
        let schema = self.schema.as_ref().and_then(|it| Schema::parse(it).ok());
        schema.map_or_else(|| "bytes".to_owned(), |it| it.encoding().name().to_owned())
    }

    /// The encoding and the content of the schema record. Both are empty without a schema text.
    pub(crate) fn schema_record(&self) -> (&'static str, &[u8]) {
        match (&self.schema, self.definition()) {
            (_, Some((_, definition))) => (ROS_SCHEMA_ENCODING, definition.as_bytes()),
            (Some(text), None) => (SCHEMA_ENCODING, text.as_bytes()),
            (None, None) => ("", &[]),
        }
    }

    /// The RIHS01 hash and the definition of a type of ROS 2: the two parts of its schema text (SM2-TYP-002).
    fn definition(&self) -> Option<(&str, &str)> {
        let text = self.schema.as_deref()?;
        match Schema::parse(text).ok()?.root() {
            Root::Definition(_) => text.strip_prefix("cdr:")?.split_once('\n'),
            Root::Type(_) => None,
        }
    }

    pub(crate) fn metadata(&self) -> BTreeMap<String, String> {
        let qos = serde_json::to_string(&self.offer).expect("numbers and flags");
        let mut metadata = BTreeMap::from(
            [
                (Self::TYPE, self.data.name.to_string()),
                (Self::HASH, hash_text(&self.data)),
                (Self::PUBLISHER, self.publisher.to_string()),
                (Self::QOS, qos),
            ]
            .map(|(key, value)| (key.to_owned(), value)),
        );
        if let Some((rihs01, _)) = self.definition() {
            metadata.insert(Self::RIHS01.to_owned(), rihs01.to_owned());
            metadata.insert(ros_qos::KEY.to_owned(), ros_qos::write(&self.offer));
        }
        metadata
    }

    /// The type, for summaries.
    pub(crate) fn topic_type(&self) -> TopicType {
        TopicType {
            name: self.data.name.to_string(),
            hash: Some(hash_text(&self.data)),
        }
    }

    /// The type that the channel of a bag of any program states.
    pub(crate) fn stated_type(channel: &mcap::Channel<'_>) -> TopicType {
        let schema = channel.schema.as_ref();
        TopicType {
            name: schema.map(|it| it.name.clone()).unwrap_or_default(),
            hash: channel.metadata.get(Self::HASH).cloned(),
        }
    }

    /// A publisher of bytes that keeps so many messages for late subscribers.
    #[cfg(test)]
    pub(crate) fn of_test(publisher: &str, latched: u16) -> std::sync::Arc<Self> {
        let name = |text| Name::new(text).expect("a legal name");
        std::sync::Arc::new(Self {
            topic: name("map"),
            publisher: name(publisher),
            data: TypeId {
                name: name("bytes"),
                hash: 0,
            },
            offer: OfferedQos {
                latched,
                ..UNKNOWN_OFFER
            },
            schema: None,
        })
    }

    /// The channel of this publisher, the only one of a bag.
    #[cfg(any(test, feature = "fuzzing"))]
    pub(crate) fn channel(&self) -> mcap::Channel<'_> {
        let (encoding, data) = self.schema_record();
        mcap::Channel {
            id: 1,
            topic: self.topic.to_string(),
            schema: Some(std::sync::Arc::new(mcap::Schema {
                id: 1,
                name: self.data.name.to_string(),
                encoding: encoding.to_owned(),
                data: data.into(),
            })),
            message_encoding: self.message_encoding(),
            metadata: self.metadata(),
        }
    }

    /// Reads the channel of a bag. `None` if another program than SM2 made it: see [`foreign`](crate::foreign).
    pub(crate) fn of_channel(channel: &mcap::Channel<'_>) -> Option<Self> {
        let text = |key| channel.metadata.get(key);
        let name = |key| Name::new(text(key)?).ok();
        let schema = channel.schema.as_deref().and_then(|it| {
            let content = str::from_utf8(&it.data).ok()?;
            match it.encoding.as_str() {
                SCHEMA_ENCODING => Some(content.to_owned()),
                ROS_SCHEMA_ENCODING => Some(format!("cdr:{}\n{content}", text(Self::RIHS01)?)),
                _ => None,
            }
        });
        Some(Self {
            topic: Name::new(&channel.topic).ok()?,
            publisher: name(Self::PUBLISHER)?,
            data: TypeId {
                name: name(Self::TYPE)?,
                hash: u64::from_str_radix(text(Self::HASH)?, 16).ok()?,
            },
            offer: serde_json::from_str(text(Self::QOS)?).ok()?,
            schema,
        })
    }
}

#[cfg(test)]
mod tests {
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
                reliable: true,
                latched: 1,
                deadline: Period(5),
                lease: Period(7),
                ..OfferedQos::new(8)
            },
            schema: schema.map(str::to_owned),
        }
    }

    #[test]
    fn a_channel_has_the_whole_publisher() {
        for (schema, encoding) in [(Some("plain:string"), "plain"), (None, "bytes")] {
            let source = source(schema);
            let channel = source.channel();
            assert_eq!(channel.message_encoding, encoding);
            assert_eq!(Source::of_channel(&channel), Some(source));
        }
    }

    //= SM2-TYP-002 test
    #[test]
    fn a_type_of_ros_2_has_the_records_of_ros_2() {
        let rihs01 = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        let source = source(Some(&format!("cdr:{rihs01}\nstring data\n")));
        let channel = source.channel();
        let schema = channel.schema.as_ref().unwrap();
        assert_eq!(channel.message_encoding, "cdr");
        assert_eq!(schema.encoding, "ros2msg");
        assert_eq!(*schema.data, *b"string data\n");
        assert_eq!(channel.metadata["topic_type_hash"], rihs01);
        let qos = &channel.metadata["offered_qos_profiles"];
        assert!(qos.contains("reliability: reliable"), "{qos}");
        assert_eq!(Source::of_channel(&channel), Some(source.clone()));
        // Without its hash, the definition is not a schema text.
        let mut channel = channel;
        channel.metadata.remove(Source::RIHS01);
        let schema = None;
        assert_eq!(
            Source::of_channel(&channel),
            Some(Source {
                schema,
                ..source.clone()
            })
        );
    }

    #[test]
    fn a_channel_of_another_program_has_no_publisher() {
        let source = source(None);
        for key in [Source::TYPE, Source::HASH, Source::PUBLISHER, Source::QOS] {
            let mut channel = source.channel();
            channel.metadata.insert(key.to_owned(), "//".to_owned());
            assert_eq!(Source::of_channel(&channel), None, "{key}");
            channel.metadata.remove(key);
            assert_eq!(Source::of_channel(&channel), None, "{key}");
        }
    }
}
