//! The definitions of ROS 2's common interfaces, for programs that learn at run time which types they use.

use std::collections::BTreeSet;

use sm2_ros_idl::{Base, Set, TypeName};

/// The names and the definitions, sorted by name. Each is the content of one file.
const COMMON_INTERFACES: &[(&str, &str)] =
    include!(concat!(env!("OUT_DIR"), "/common_interfaces.rs"));

/// Adds the definitions of the common interfaces that the type `name` refers to, and that of the type itself. Types
/// that `set` has already stay as they are. Types that nothing defines stay missing.
pub fn complete(set: &mut Set, name: &TypeName) {
    let mut seen = BTreeSet::new();
    let mut wanted = vec![name.clone()];
    while let Some(name) = wanted.pop() {
        if set.get(&name).is_err() {
            add_common(set, &name);
        }
        let fields = set.get(&name).map_or(&[][..], |it| &it.fields);
        let parts = fields.iter().filter_map(|it| match &it.ty.base {
            Base::Message(part) => Some(part.clone()),
            _ => None,
        });
        wanted.extend(parts.filter(|it| seen.insert(it.clone())));
    }
}

/// Adds the file of the common interfaces that defines a type, if there is one.
fn add_common(set: &mut Set, name: &TypeName) {
    // A part of a service or action is in the file whose name it begins with, such as `SetBool_Request`.
    let name = name.to_string();
    let ends = name.match_indices('_').map(|(at, _)| at);
    let files = ends
        .chain([name.len()])
        .filter_map(|end| name.get(..end))
        .filter_map(common);
    for (name, text) in files {
        // A unit test reads all of them.
        if let Ok(name) = name.parse() {
            let _known = set.add(&name, text);
        }
    }
}

fn common(file: &str) -> Option<&'static (&'static str, &'static str)> {
    let found = COMMON_INTERFACES.binary_search_by_key(&file, |(name, _)| name);
    COMMON_INTERFACES.get(found.ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_common_interfaces_have_a_schema() {
        let mut set = Set::default();
        for (name, text) in COMMON_INTERFACES {
            set.add(&name.parse().unwrap(), text).unwrap();
        }
        assert!(COMMON_INTERFACES.len() > 100);
        for message in set.types() {
            let text = set.schema_text(&message.name).unwrap();
            let mut one = Set::default();
            complete(&mut one, &message.name);
            assert_eq!(one.schema_text(&message.name), Ok(text));
        }
    }

    #[test]
    fn only_the_types_that_a_type_needs_are_added() {
        let mut set = Set::default();
        complete(&mut set, &"geometry_msgs/msg/PoseStamped".parse().unwrap());
        assert_eq!(set.types().count(), 6);
        for absent in ["std_msgs/msg/Nothing", "std_srvs/srv/SetBool_Nothing"] {
            let name = absent.parse().unwrap();
            complete(&mut set, &name);
            assert!(set.get(&name).is_err(), "{absent}");
        }
    }
}
