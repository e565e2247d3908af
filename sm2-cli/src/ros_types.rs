//! Types of ROS 2, whose names and definitions determine their hashes and schemas: those of the common interfaces,
//! and those of the user's packages.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    sync::OnceLock,
};

use clap::Args;
use sm2_proto::{Name, TypeId, schema::Schema};
use sm2_ros_idl::{Base, Kind, Set, TypeName};

use crate::{
    built_in::{self, BuiltIn},
    decode::CodecError,
    error::CliError,
};

/// The names and the definitions of ROS 2's common interfaces, sorted by name. Each is the content of one file.
const COMMON_INTERFACES: &[(&str, &str)] =
    include!(concat!(env!("OUT_DIR"), "/common_interfaces.rs"));

/// The definitions that the user adds.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct Definitions {
    /// A package with definitions of ROS 2 (PACKAGE/msg/NAME.msg), or a folder of packages (may be given again). The
    /// common interfaces, such as sensor_msgs, are built in
    #[arg(long = "definitions", value_name = "FOLDER")]
    folders: Vec<PathBuf>,
    /// The types in these folders, once they were read.
    #[arg(skip)]
    added: OnceLock<Set>,
}

impl Definitions {
    /// The type of this name: a built-in type of SM2, else a type of ROS 2. `None` if nothing defines it.
    ///
    /// # Errors
    ///
    /// [`CliError::Definitions`] if a folder or a definition in it cannot be read; [`CliError::Definition`] if the type
    /// refers to one that nothing defines.
    pub(crate) fn known(&self, name: &Name) -> Result<Option<BuiltIn>, CliError> {
        match built_in::named(name) {
            Some(known) => Ok(Some(known)),
            None => self.of_ros(name),
        }
    }

    /// The type of ROS 2 with this name. `None` if nothing defines it.
    ///
    /// # Errors
    ///
    /// As [`known`](Self::known).
    pub(crate) fn of_ros(&self, name: &Name) -> Result<Option<BuiltIn>, CliError> {
        let Ok(type_name) = name.as_str().parse::<TypeName>() else {
            return Ok(None);
        };
        let set = self.read(&type_name)?;
        if set.get(&type_name).is_err() {
            return Ok(None);
        }
        let wrong = |reason| CliError::Definition {
            data: name.to_string(),
            reason,
        };
        let text = set.schema_text(&type_name);
        let text = text.map_err(|error| wrong(CodecError::Set(error)))?;
        let schema = Schema::parse(&text).map_err(|error| wrong(CodecError::Text(error)))?;
        Ok(Some(BuiltIn {
            data: TypeId {
                name: name.clone(),
                hash: schema.hash(),
            },
            schema: Some(text),
        }))
    }

    /// Whether the user has added definitions.
    pub(crate) const fn is_empty(&self) -> bool {
        self.folders.is_empty()
    }

    /// The definitions of the user, and those of the common interfaces that `name` refers to. Those of the user replace
    /// those of the same names.
    fn read(&self, name: &TypeName) -> Result<Set, CliError> {
        let mut set = self.added()?.clone();
        let mut seen = BTreeSet::new();
        let mut wanted = vec![name.clone()];
        while let Some(name) = wanted.pop() {
            if set.get(&name).is_err() {
                add_common(&mut set, &name);
            }
            let fields = set.get(&name).map_or(&[][..], |it| &it.fields);
            let parts = fields.iter().filter_map(|it| match &it.ty.base {
                Base::Message(part) => Some(part.clone()),
                _ => None,
            });
            wanted.extend(parts.filter(|it| seen.insert(it.clone())));
        }
        Ok(set)
    }

    /// The definitions of the user.
    fn added(&self) -> Result<&Set, CliError> {
        if let Some(set) = self.added.get() {
            return Ok(set);
        }
        let mut set = Set::default();
        for folder in &self.folders {
            match is_package(folder) {
                true => set.add_package(&std::path::absolute(folder).unwrap_or_default())?,
                false => set.add_folder(folder)?,
            }
        }
        Ok(self.added.get_or_init(|| set))
    }
}

/// Adds the file of the common interfaces that defines a type, if there is one.
fn add_common(set: &mut Set, name: &TypeName) {
    // A part of a service or action is in the file whose name it begins with, such as `SetBool_Request`.
    let name = name.to_string();
    let ends = name.match_indices('_').map(|(at, _)| at);
    let files = ends.chain([name.len()]).map(|end| &name[..end]);
    for file in files {
        let found = COMMON_INTERFACES.binary_search_by_key(&file, |(name, _)| name);
        // A unit test reads all of them.
        if let (Ok(at), Ok(name)) = (found, file.parse()) {
            let _known = set.add(&name, COMMON_INTERFACES[at].1);
        }
    }
}

fn is_package(folder: &Path) -> bool {
    Kind::ALL.iter().any(|it| folder.join(it.name()).is_dir())
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
            Schema::parse(&text).unwrap();
            let name = Name::new(&message.name.to_string()).unwrap();
            let found = Definitions::default().known(&name).unwrap().unwrap();
            assert_eq!(found.schema, Some(text), "{name}");
        }
        // The lookup reads the files that the type needs.
        let pose = "geometry_msgs/msg/PoseStamped".parse().unwrap();
        let set = Definitions::default().read(&pose).unwrap();
        assert_eq!(set.types().count(), 6);
    }

    #[test]
    fn a_name_stands_for_the_type_of_ros_2() {
        let named = |name| Definitions::default().known(&Name::new(name).unwrap());
        let text = named("std_msgs/msg/String").unwrap().unwrap();
        let expected = "cdr:RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18\nstring data\n";
        assert_eq!(text.schema.as_deref(), Some(expected));
        for absent in [
            "std_msgs/msg/Nothing",
            "nav/Goal",
            "std_srvs/srv/SetBool_Nothing",
        ] {
            assert!(named(absent).unwrap().is_none(), "{absent}");
        }
    }
}
