//! Types of ROS 2, whose names and definitions determine their hashes and schemas: those of the common interfaces,
//! and those of the user's packages.

use std::{path::PathBuf, sync::OnceLock};

use clap::Args;
use sm2_proto::{Name, TypeId, schema::Schema};
use sm2_ros::definitions;
use sm2_ros_idl::{Set, TypeName};

use crate::{
    built_in::{self, BuiltIn},
    decode::CodecError,
    error::CliError,
};

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
        definitions::complete(&mut set, name);
        Ok(set)
    }

    /// The definitions of the user.
    fn added(&self) -> Result<&Set, CliError> {
        if let Some(set) = self.added.get() {
            return Ok(set);
        }
        let mut set = Set::default();
        for folder in &self.folders {
            set.add_definitions(folder).map_err(CliError::Definitions)?;
        }
        Ok(self.added.get_or_init(|| set))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
