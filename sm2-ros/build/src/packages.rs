//! The packages that code is generated for or refers to.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use proc_macro2::TokenStream;
use sm2_ros_idl::{Kind, TypeName};

/// Packages by name.
#[derive(Debug, Default)]
pub(crate) struct Packages(BTreeMap<String, Package>);

#[derive(Debug)]
pub(crate) struct Package {
    /// The folder with the definitions.
    pub(crate) folder: PathBuf,
    /// The path of the Rust module that already has the package; `None` if its code is to be generated.
    pub(crate) root: Option<TokenStream>,
}

impl Packages {
    pub(crate) fn contains(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    pub(crate) fn insert(&mut self, name: String, package: Package) {
        self.0.insert(name, package);
    }

    pub(crate) fn is_generated(&self, name: &TypeName) -> bool {
        self.0
            .get(name.package())
            .is_some_and(|it| it.root.is_none())
    }

    /// The module that has the package of this type, if that is not the generated file.
    pub(crate) fn external(&self, name: &TypeName) -> Option<&TokenStream> {
        self.0.get(name.package())?.root.as_ref()
    }

    /// Finds the line of a field or constant of a type: the first line of its file that begins with a type and this
    /// name, and has this value. Services and actions have several types in one file.
    pub(crate) fn find_line(
        &self,
        ty: &TypeName,
        member: &str,
        value: &str,
    ) -> Option<(PathBuf, usize)> {
        let package = self.0.get(ty.package())?;
        let kind = ty.kind().name();
        let underscores = ty.name().match_indices('_').map(|(at, _)| at);
        let ends = underscores.filter(|_| ty.kind() != Kind::Msg);
        ends.chain([ty.name().len()]).find_map(|end| {
            let file = format!("{}.{kind}", &ty.name()[..end]);
            let path = package.folder.join(kind).join(file);
            let text = fs::read_to_string(&path).ok()?;
            let line = text.lines().position(|line| {
                let mut words = line.split_ascii_whitespace();
                let is_comment = words.next().is_none_or(|it| it.starts_with('#'));
                let name = words.next().and_then(|it| it.split('=').next());
                !is_comment && name == Some(member) && line.contains(value)
            });
            Some((path, line? + 1))
        })
    }
}
