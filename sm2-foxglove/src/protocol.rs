//! The messages of the Foxglove WebSocket protocol that this server uses.
//!
//! The crate `foxglove` has them for its own server only, undocumented. The tests read what is written here with it.

use serde::{Deserialize, Serialize};
use sm2_proto::clock::DomainTime;

/// The subprotocols that the server speaks, the preferred one first. Their messages are the same as far as they are
/// used here.
pub(crate) const SUBPROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];

/// A message to a viewer, in JSON.
#[derive(Debug, Serialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
pub(crate) enum ToViewer<'a> {
    ServerInfo {
        name: &'a str,
        capabilities: &'a [&'a str],
        supported_encodings: &'a [&'a str],
        session_id: &'a str,
    },
    Status {
        level: Level,
        message: String,
    },
    Advertise {
        channels: Vec<Channel<'a>>,
    },
    Unadvertise {
        channel_ids: Vec<u64>,
    },
    AdvertiseServices {
        services: Vec<Service<'a>>,
    },
    UnadvertiseServices {
        service_ids: Vec<u32>,
    },
    ServiceCallFailure {
        service_id: u32,
        call_id: u32,
        message: String,
    },
    ConnectionGraphUpdate(GraphUpdate),
}

/// The severity of a status.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Level {
    Warning,
    Error,
}

impl Serialize for Level {
    fn serialize<S: serde::Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_u8(match self {
            Self::Warning => 1,
            Self::Error => 2,
        })
    }
}

/// A topic with one type.
#[derive(Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Channel<'a> {
    pub(crate) id: u64,
    pub(crate) topic: &'a str,
    #[serde(flatten)]
    pub(crate) messages: Messages<'a>,
}

/// A service.
#[derive(Debug, Serialize)]
pub(crate) struct Service<'a> {
    pub(crate) id: u32,
    pub(crate) name: &'a str,
    #[serde(rename = "type")]
    pub(crate) types: String,
    pub(crate) request: Messages<'a>,
    pub(crate) response: Messages<'a>,
}

/// The form of the messages of a topic, or of the requests or replies of a service.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Messages<'a> {
    pub(crate) encoding: &'a str,
    pub(crate) schema_name: &'a str,
    pub(crate) schema_encoding: &'a str,
    pub(crate) schema: &'a str,
}

/// The changes of the connection graph.
#[derive(Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct GraphUpdate {
    pub(crate) published_topics: Vec<Publishers>,
    pub(crate) subscribed_topics: Vec<Subscribers>,
    pub(crate) advertised_services: Vec<Providers>,
    pub(crate) removed_topics: Vec<String>,
    pub(crate) removed_services: Vec<String>,
}

/// The nodes that publish a topic.
#[derive(Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Publishers {
    pub(crate) name: String,
    pub(crate) publisher_ids: Vec<String>,
}

/// The nodes that subscribe to a topic.
#[derive(Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Subscribers {
    pub(crate) name: String,
    pub(crate) subscriber_ids: Vec<String>,
}

/// The nodes that serve a service.
#[derive(Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Providers {
    pub(crate) name: String,
    pub(crate) provider_ids: Vec<String>,
}

/// The opcodes of binary messages to a viewer.
const MESSAGE_DATA: u8 = 1;
const TIME: u8 = 2;
const SERVICE_CALL_RESPONSE: u8 = 3;

/// The head of a message of a topic.
pub(crate) fn message_head(subscription: u32, time: DomainTime) -> [u8; 13] {
    let mut head = [0; 13];
    head[0] = MESSAGE_DATA;
    head[1..5].copy_from_slice(&subscription.to_le_bytes());
    head[5..].copy_from_slice(&time.0.to_le_bytes());
    head
}

/// The time of the domain.
pub(crate) fn time(time: DomainTime) -> [u8; 9] {
    let mut message = [0; 9];
    message[0] = TIME;
    message[1..].copy_from_slice(&time.0.to_le_bytes());
    message
}

/// The head of a reply.
pub(crate) fn reply_head(service: u32, call: u32, encoding: &str) -> Vec<u8> {
    let len = encoding.len() as u32;
    let mut head = vec![SERVICE_CALL_RESPONSE];
    for number in [service, call, len] {
        head.extend(number.to_le_bytes());
    }
    head.extend(encoding.as_bytes());
    head
}

/// A message of a viewer, in JSON.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
pub(crate) enum FromViewer {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    Advertise {
        channels: Vec<Publication>,
    },
    Unadvertise {
        channel_ids: Vec<u32>,
    },
    SubscribeConnectionGraph,
    UnsubscribeConnectionGraph,
    /// An operation of a capability that this server does not offer.
    #[serde(other)]
    Unsupported,
}

/// A subscription of a viewer to a channel.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Subscription {
    pub(crate) id: u32,
    pub(crate) channel_id: u64,
}

/// A topic that a viewer publishes.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct Publication {
    pub(crate) id: u32,
    pub(crate) topic: String,
    pub(crate) encoding: String,
    pub(crate) schema_name: String,
    #[serde(default)]
    pub(crate) schema: Option<String>,
}

/// A binary message of a viewer.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum BinaryFromViewer<'a> {
    Message {
        publication: u32,
        payload: &'a [u8],
    },
    Request {
        service: u32,
        call: u32,
        encoding: &'a str,
        payload: &'a [u8],
    },
}

/// Reads a binary message of a viewer. `None` if it is none of this protocol.
pub(crate) fn binary(message: &[u8]) -> Option<BinaryFromViewer<'_>> {
    let (opcode, rest) = message.split_first()?;
    let (first, rest) = number(rest)?;
    match opcode {
        1 => Some(BinaryFromViewer::Message {
            publication: first,
            payload: rest,
        }),
        2 => {
            let (call, rest) = number(rest)?;
            let (len, rest) = number(rest)?;
            let (encoding, payload) = rest.split_at_checked(len as usize)?;
            Some(BinaryFromViewer::Request {
                service: first,
                call,
                encoding: str::from_utf8(encoding).ok()?,
                payload,
            })
        }
        _ => None,
    }
}

fn number(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (number, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(*number), rest))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn requests_are_read() {
        let message = [&[2, 1, 0, 0, 0, 7, 0, 0, 0, 3, 0, 0, 0][..], b"cdr", b"xy"].concat();
        let expected = BinaryFromViewer::Request {
            service: 1,
            call: 7,
            encoding: "cdr",
            payload: b"xy",
        };
        assert_eq!(binary(&message), Some(expected));
        // Up to the end of the encoding, every part is needed.
        for len in 0..message.len() - 2 {
            assert_eq!(binary(&message[..len]), None, "{len} bytes");
        }
    }

    proptest! {
        /// No message of a viewer makes the server panic, and a message that is read has the bytes that were sent.
        #[test]
        fn any_bytes_can_be_read(message: Vec<u8>, opcode in 0..4_u8) {
            let message = [&[opcode][..], &message].concat();
            match binary(&message) {
                Some(BinaryFromViewer::Message { publication, payload }) => {
                    prop_assert_eq!(opcode, 1);
                    prop_assert_eq!(&message[1..5], &publication.to_le_bytes());
                    prop_assert_eq!(&message[5..], payload);
                }
                Some(BinaryFromViewer::Request { encoding, payload, .. }) => {
                    prop_assert_eq!(opcode, 2);
                    prop_assert_eq!(&message[13..13 + encoding.len()], encoding.as_bytes());
                    prop_assert_eq!(&message[13 + encoding.len()..], payload);
                }
                None => prop_assert!(opcode != 1 || message.len() < 5),
            }
        }
    }
}
