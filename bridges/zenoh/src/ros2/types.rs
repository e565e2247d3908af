//! Types of ROS 2, and their names in the network.

use hiroz_protocol::format::rmw_zenoh::{dds_type_name, ros_type_name};
use hiroz_protocol::{TypeHash, TypeInfo};
use sm2_proto::schema::{Root, Schema, hash};
use sm2_proto::{Name, TypeId};
use sm2_ros_idl::{Kind, Set, TypeName};

/// The line between two definitions, and the start of the next one.
const SEPARATOR: &str =
    "================================================================================\nMSG: ";
/// The types that the event of a service has, beside its request and its reply.
const EVENT: [(&str, &str); 2] = [
    (
        "builtin_interfaces/Time",
        include_str!("../../../../sm2-ros/definitions/builtin_interfaces/msg/Time.msg"),
    ),
    (
        "service_msgs/ServiceEventInfo",
        include_str!("../../../../sm2-ros/definitions/service_msgs/msg/ServiceEventInfo.msg"),
    ),
];

/// The version of the hashes that have the prefix `RIHS01_`.
const RIHS_VERSION: u8 = 1;

/// A type of messages of ROS 2.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct RosType {
    /// The name, such as `std_msgs/msg/String`.
    name: Name,
    rihs01: [u8; 32],
}

impl RosType {
    /// The type in the domain.
    pub(crate) fn data(&self) -> TypeId {
        TypeId {
            name: self.name.clone(),
            hash: hash::cdr(&self.rihs01),
        }
    }

    /// The type of a schema text that a node of the domain has registered. `None` if it is not one of ROS 2.
    pub(crate) fn of_schema(data: &TypeId, text: &str) -> Option<Self> {
        let schema = Schema::parse(text).ok()?;
        let Root::Definition(definition) = schema.root() else {
            return None;
        };
        let it = Self {
            name: data.name.clone(),
            rihs01: *definition.rihs01(),
        };
        (it.data() == *data && it.info().is_some()).then_some(it)
    }

    /// The service whose requests and replies have these types and schema texts. `None` if it is not one of ROS 2.
    pub(crate) fn of_service(request: (&TypeId, &str), reply: (&TypeId, &str)) -> Option<Self> {
        let stem = request.0.name.as_str().strip_suffix("_Request")?;
        if reply.0.name.as_str().strip_suffix("_Response")? != stem {
            return None;
        }
        let name = service_name(stem)?;
        let mut set = Set::default();
        for (name, text) in EVENT {
            set.add(&message_name(name)?, text).ok()?;
        }
        let request_fields = add_parts(&mut set, request)?;
        let reply_fields = add_parts(&mut set, reply)?;
        set.add(&name, &format!("{request_fields}---\n{reply_fields}"))
            .ok()?;
        let it = Self {
            name: Name::new(stem).ok()?,
            rihs01: set.hash(&name).ok()?.0,
        };
        it.info().is_some().then_some(it)
    }

    /// The type of an endpoint of the network. `None` if its name or its hash is not in the form of ROS 2.
    pub(crate) fn of_info(info: &TypeInfo) -> Option<Self> {
        // The hash of a version of ROS 2 without hashes is all zero.
        if info.hash.version != RIHS_VERSION || info.hash.value == [0; 32] {
            return None;
        }
        let it = Self {
            name: Name::new(&ros_type_name(&info.name)).ok()?,
            rihs01: info.hash.value,
        };
        (it.info()? == *info).then_some(it)
    }

    /// The type in the network. `None` if the name does not have the form `PACKAGE/KIND/NAME`.
    pub(crate) fn info(&self) -> Option<TypeInfo> {
        let (namespace, name) = self.name.as_str().rsplit_once('/')?;
        let (package, kind) = namespace.split_once('/')?;
        if kind.contains('/') {
            return None;
        }
        let name = dds_type_name(&format!("{package}::{kind}"), name);
        Some(TypeInfo::new(
            &name,
            TypeHash::new(RIHS_VERSION, self.rihs01),
        ))
    }
}

fn service_name(name: &str) -> Option<TypeName> {
    let (package, name) = name.split_once("/srv/")?;
    TypeName::new(package, Kind::Srv, name).ok()
}

/// The name of a message without its kind, as in `std_msgs/Header`.
fn message_name(name: &str) -> Option<TypeName> {
    let (package, name) = name.split_once('/')?;
    TypeName::new(package, Kind::Msg, name).ok()
}

/// Adds the parts of a type to a set. Returns the fields of the type itself.
fn add_parts(set: &mut Set, (data, text): (&TypeId, &str)) -> Option<String> {
    // The schema text states a hash: the definitions must have it.
    RosType::of_schema(data, text)?;
    let (_, text) = text.split_once('\n')?;
    let mut sections = text.split(SEPARATOR);
    let fields = sections.next()?;
    for section in sections {
        let (name, text) = section.split_once('\n')?;
        set.add(&message_name(name)?, text).ok()?;
    }
    Some(fields.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    const STRING: &str = "cdr:RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18\nstring data\n";

    fn string() -> RosType {
        let hash = Schema::parse(STRING).unwrap().hash();
        let name = Name::new("std_msgs/msg/String").unwrap();
        RosType::of_schema(&TypeId { name, hash }, STRING).unwrap()
    }

    #[test]
    fn a_type_has_the_names_of_both_sides() {
        let info = string().info().unwrap();
        assert_eq!(info.name, "std_msgs::msg::dds_::String_");
        assert_eq!(
            format!("cdr:{}\nstring data\n", info.hash.to_rihs_string()),
            STRING
        );
        assert_eq!(RosType::of_info(&info), Some(string()));
    }

    /// The hash is that of ROS 2 (`ros2 interface show --no-comments`, `rosidl_generate_type_hash`).
    #[test]
    fn the_hash_of_a_service_comes_from_its_request_and_reply() {
        let types = |texts: [&str; 2]| {
            let name = TypeName::new("std_srvs", Kind::Srv, "SetBool").unwrap();
            let mut set = Set::default();
            for (part, text) in EVENT {
                set.add(&message_name(part).unwrap(), text).unwrap();
            }
            set.add(&name, &format!("{}---\n{}", texts[0], texts[1]))
                .unwrap();
            let part = |suffix: &str| {
                let name =
                    TypeName::new("std_srvs", Kind::Srv, &format!("SetBool_{suffix}")).unwrap();
                let text = set.schema_text(&name).unwrap();
                let hash = Schema::parse(&text).unwrap().hash();
                (
                    TypeId {
                        name: Name::new(&name.to_string()).unwrap(),
                        hash,
                    },
                    text,
                )
            };
            (
                part("Request"),
                part("Response"),
                set.hash(&name).unwrap().0,
            )
        };
        let (request, reply, hash) = types(["bool data\n", "bool success\nstring message\n"]);
        let service = RosType::of_service((&request.0, &request.1), (&reply.0, &reply.1)).unwrap();
        assert_eq!(service.name.as_str(), "std_srvs/srv/SetBool");
        assert_eq!(service.rihs01, hash);
        assert_eq!(
            service.info().unwrap().name,
            "std_srvs::srv::dds_::SetBool_"
        );
        assert_eq!(
            RosType::of_service((&reply.0, &reply.1), (&request.0, &request.1)),
            None
        );
        assert_eq!(
            RosType::of_service((&request.0, "plain:u64"), (&reply.0, &reply.1)),
            None
        );
    }

    #[test]
    fn types_of_other_forms_are_none_of_ros_2() {
        let data = string().data();
        assert_eq!(RosType::of_schema(&data, "plain:u64"), None);
        let other_hash = TypeId {
            hash: data.hash + 1,
            ..data.clone()
        };
        assert_eq!(RosType::of_schema(&other_hash, STRING), None);
        for name in ["String", "std_msgs/String", "a/std_msgs/msg/String"] {
            let name = Name::new(name).unwrap();
            let renamed = TypeId {
                name,
                ..data.clone()
            };
            assert_eq!(RosType::of_schema(&renamed, STRING), None);
        }
        let info = string().info().unwrap();
        for (name, hash) in [
            ("String", info.hash.clone()),
            ("std_msgs/msg/String", info.hash.clone()),
            (&info.name, TypeHash::zero()),
            (&info.name, TypeHash::new(0, info.hash.value)),
        ] {
            assert_eq!(RosType::of_info(&TypeInfo::new(name, hash)), None, "{name}");
        }
    }
}
