//! The form of a message in the stream.
//!
//! | part | content |
//! | --- | --- |
//! | subject | the prefix and the topic, with dots: `sm2.camera.image` |
//! | header `Sm2-Type` | name and hash of the type: `pose:0000000000000012` |
//! | header `Sm2-Origin` | epoch, number and bridge: `1800000000000000000 7 robot` |
//! | header `Nats-Msg-Id` | origin and topic; the stream recognizes by it a message that comes again |
//! | payload | that of the domain |

use async_nats::HeaderMap;
use async_nats::header::NATS_MESSAGE_ID;
use bytes::Bytes;
use sm2_bridge_core::{Arrival, Delivery, Durable, Origin};
use sm2_node::Message as _;
use sm2_proto::{Name, TypeId};

const TYPE: &str = "Sm2-Type";
const ORIGIN: &str = "Sm2-Origin";

/// A message of the stream.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Message {
    pub(crate) arrival: Arrival,
    pub(crate) payload: Bytes,
}

pub(crate) fn subject(prefix: &str, topic: &Name) -> String {
    format!("{prefix}.{}", topic.as_str().replace('/', "."))
}

pub(crate) fn headers(message: &Durable) -> HeaderMap {
    let Origin {
        bridge,
        epoch,
        number,
    } = &message.origin;
    let mut headers = HeaderMap::new();
    let data = &message.data;
    headers.insert(TYPE, format!("{}:{:016x}", data.name, data.hash));
    headers.insert(ORIGIN, format!("{epoch} {number} {bridge}"));
    let id = format!("{epoch} {number} {bridge} {}", message.topic);
    headers.insert(NATS_MESSAGE_ID, id);
    headers
}

/// Reads a message. `None` if the domain has no names for its topic or its type.
pub(crate) fn read(prefix: &str, message: &async_nats::Message) -> Option<Message> {
    let rest = message.subject.strip_prefix(prefix)?.strip_prefix('.')?;
    let header = |name: &str| {
        let headers = message.headers.as_ref()?;
        headers.get(name).map(async_nats::HeaderValue::as_str)
    };
    let topic = Name::new(&rest.replace('.', "/")).ok()?;
    let data = match header(TYPE) {
        Some(text) => type_of(text)?,
        None => <[u8]>::type_id(),
    };
    Some(Message {
        arrival: Arrival {
            topic: (topic, data),
            origin: header(ORIGIN).and_then(origin_of),
            delivery: Delivery::AtLeastOnce,
        },
        payload: message.payload.clone(),
    })
}

fn type_of(text: &str) -> Option<TypeId> {
    let (name, hash) = text.split_once(':')?;
    Some(TypeId {
        name: Name::new(name).ok()?,
        hash: u64::from_str_radix(hash, 16).ok()?,
    })
}

fn origin_of(text: &str) -> Option<Origin> {
    let (epoch, rest) = text.split_once(' ')?;
    let (number, bridge) = rest.split_once(' ')?;
    Some(Origin {
        bridge: Name::new(bridge).ok()?,
        epoch: epoch.parse().ok()?,
        number: number.parse().ok()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_comes_back_and_a_foreign_one_has_the_type_of_bytes() {
        let durable = Durable {
            topic: Name::new("arm/pose").unwrap(),
            data: TypeId {
                name: Name::new("geometry/pose").unwrap(),
                hash: 0x12,
            },
            origin: Origin {
                bridge: Name::new("robot/7").unwrap(),
                epoch: 3,
                number: 4,
            },
            time: 5,
            payload: Bytes::from_static(b"x"),
        };
        let subject = subject("fleet.a", &durable.topic);
        assert_eq!(subject, "fleet.a.arm.pose");
        let mut message = async_nats::Message {
            subject: subject.into(),
            reply: None,
            payload: durable.payload.clone(),
            headers: Some(headers(&durable)),
            status: None,
            description: None,
            length: 0,
        };
        let expected = Message {
            arrival: Arrival {
                topic: (durable.topic, durable.data),
                origin: Some(durable.origin),
                delivery: Delivery::AtLeastOnce,
            },
            payload: durable.payload,
        };
        assert_eq!(read("fleet.a", &message), Some(expected));
        assert_eq!(read("fleet.b", &message), None);
        message.headers = None;
        let foreign = read("fleet.a", &message).unwrap().arrival;
        assert_eq!((foreign.topic.1, foreign.origin), (<[u8]>::type_id(), None));
        let mut damaged = HeaderMap::new();
        damaged.insert(TYPE, "no type");
        message.headers = Some(damaged);
        assert_eq!(read("fleet.a", &message), None);
    }
}
