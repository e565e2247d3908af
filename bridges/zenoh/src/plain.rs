//! The form of SM2: the names of the domain below a prefix, and its types as schemas of encodings.
//!
//! | key expression | use |
//! | --- | --- |
//! | `PREFIX/NAME` | the messages of a topic, and the queryable of a service |
//! | `PREFIX/@member/BRIDGE` | liveliness token of each bridge |
//! | `PREFIX/@service/BRIDGE/NAME/REQUEST/REPLY` | liveliness token of each service that a bridge offers |
//!
//! In the token, `%` stands for each `/` of a name, and a type is `NAME:HASH`.

use sm2_bridge_core::domain::Service;
use sm2_node::Message as _;
use sm2_proto::{Name, TypeId};
use zenoh::bytes::Encoding;

/// The start of the schema of an encoding.
const SCHEMA: &str = "sm2:";

/// The key expression of a topic.
pub(crate) fn key(prefix: &str, topic: &Name) -> String {
    format!("{prefix}/{topic}")
}

/// The topic of a key expression. `None` if it has another prefix, or if the rest is not a name.
pub(crate) fn topic(prefix: &str, key: &str) -> Option<Name> {
    let rest = key.strip_prefix(prefix)?.strip_prefix('/')?;
    Name::new(rest).ok()
}

/// The encoding of messages of a type.
pub(crate) fn encoding(data: &TypeId) -> Encoding {
    Encoding::ZENOH_BYTES.with_schema(format!("{SCHEMA}{}:{:016x}", data.name, data.hash))
}

/// The token of a bridge.
pub(crate) fn member_token(prefix: &str, bridge: &Name) -> String {
    format!("{}{bridge}", member_tokens(prefix))
}

/// The start of the tokens of all bridges.
pub(crate) fn member_tokens(prefix: &str) -> String {
    format!("{prefix}/@member/")
}

/// The bridge of a token. `None` if it is another one.
pub(crate) fn member_of(prefix: &str, token: &str) -> Option<Name> {
    Name::new(token.strip_prefix(&member_tokens(prefix))?).ok()
}

/// The token of a service that a bridge offers.
pub(crate) fn service_token(
    prefix: &str,
    bridge: &Name,
    (name, request, reply): &Service,
) -> String {
    let data = |it: &TypeId| format!("{}:{:016x}", chunk(&it.name), it.hash);
    format!(
        "{}{}/{}/{}/{}",
        service_tokens(prefix),
        chunk(bridge),
        chunk(name),
        data(request),
        data(reply)
    )
}

/// The start of the tokens of all services.
pub(crate) fn service_tokens(prefix: &str) -> String {
    format!("{prefix}/@service/")
}

/// The bridge and the service of a token. `None` if it is another one.
pub(crate) fn service_of(prefix: &str, token: &str) -> Option<(Name, Service)> {
    let rest = token.strip_prefix(&service_tokens(prefix))?;
    let [bridge, name, request, reply] = rest.split('/').collect::<Vec<_>>().try_into().ok()?;
    let name_of = |text: &str| Name::new(&text.replace('%', "/")).ok();
    let data = |text: &str| type_of_text(&text.replace('%', "/"));
    Some((
        name_of(bridge)?,
        (name_of(name)?, data(request)?, data(reply)?),
    ))
}

/// A name as one chunk of a key expression.
fn chunk(name: &Name) -> String {
    name.as_str().replace('/', "%")
}

/// Whether an encoding says a type of the domain.
pub(crate) fn has_type(encoding: &Encoding) -> bool {
    encoding.to_string().contains(&format!(";{SCHEMA}"))
}

/// The type of a message with this encoding; that of bytes for one that no bridge has put. `None` if the schema is
/// damaged.
pub(crate) fn type_of(encoding: &Encoding) -> Option<TypeId> {
    let text = encoding.to_string();
    let Some((_, schema)) = text.split_once(&format!(";{SCHEMA}")) else {
        return Some(<[u8]>::type_id());
    };
    type_of_text(schema)
}

/// The type of a text `NAME:HASH`.
fn type_of_text(text: &str) -> Option<TypeId> {
    let (name, hash) = text.split_once(':')?;
    let is_canonical = hash.len() == 16 && !hash.bytes().any(|it| it.is_ascii_uppercase());
    Some(TypeId {
        name: Name::new(name).ok()?,
        hash: u64::from_str_radix(hash, 16)
            .ok()
            .filter(|_| is_canonical)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn types_and_topics_come_back() {
        let data = TypeId {
            name: Name::new("sensor_msgs/msg/Image").unwrap(),
            hash: 0x12,
        };
        assert_eq!(
            encoding(&data).to_string(),
            "zenoh/bytes;sm2:sensor_msgs/msg/Image:0000000000000012"
        );
        assert_eq!(type_of(&encoding(&data)), Some(data));
        assert_eq!(type_of(&Encoding::TEXT_PLAIN), Some(<[u8]>::type_id()));
        for damaged in [
            "sm2:a",
            "sm2:a:12",
            "sm2:a:000000000000001G",
            "sm2:a:000000000000001A",
            "sm2:a b:0000000000000012",
        ] {
            assert_eq!(
                type_of(&Encoding::ZENOH_BYTES.with_schema(damaged)),
                None,
                "{damaged}"
            );
        }
        let service = (
            Name::new("arm/reset").unwrap(),
            type_of(&encoding(&<[u8]>::type_id())).unwrap(),
            TypeId {
                name: Name::new("a/b").unwrap(),
                hash: u64::MAX,
            },
        );
        let bridge = Name::new("robot/7").unwrap();
        let token = service_token("sm2", &bridge, &service);
        assert!(token.ends_with("/a%b:ffffffffffffffff"), "{token}");
        assert_eq!(service_of("sm2", &token), Some((bridge.clone(), service)));
        let token = member_token("sm2", &bridge);
        assert_eq!(service_of("sm2", &token), None);
        assert_eq!(member_of("sm2", &token), Some(bridge));
        assert_eq!(member_of("other", &token), None);
        for foreign in ["sm2/@service/a/b/c:0", "sm2/@bridge/a/b/c/d"] {
            assert_eq!(service_of("sm2", foreign), None, "{foreign}");
        }
        let name = Name::new("camera/image").unwrap();
        assert_eq!(topic("sm2", &key("sm2", &name)), Some(name));
        for foreign in ["sm2", "sm2/", "sm22/a", "other/a", "sm2/a.b", "sm2/@adv/x"] {
            assert_eq!(topic("sm2", foreign), None, "{foreign}");
        }
    }
}
