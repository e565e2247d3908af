//! Generates Rust types from the interface definitions of ROS 2: `.msg`, `.srv` and `.action` files.
//!
//! A package calls [`Builder`] in its `build.rs`, and includes the generated file with `sm2_ros::include_types!`.
//! The types implement `sm2_node::Message`. Topics and services of SM2 carry them as CDR, with ROS 2's names and
//! hashes.
//!
//! ```no_run
//! // build.rs
//! fn main() -> Result<(), sm2_ros_build::Error> {
//!     sm2_ros_build::Builder::new().package("msgs/my_msgs").generate()
//! }
//! ```
//!
//! | definition | in Rust |
//! | --- | --- |
//! | `my_msgs/msg/Wheel` | `my_msgs::msg::Wheel` |
//! | `my_msgs/srv/AddTwoInts` | the service `my_msgs::srv::AddTwoInts` |
//! | its messages | `AddTwoIntsRequest`, `AddTwoIntsResponse`, `AddTwoIntsEvent` |
//! | `my_msgs/action/Dock` | the action `my_msgs::action::Dock` |
//! | its messages | `DockGoal`, `DockResult`, `DockFeedback` |
//! | its services | `DockSendGoal`, `DockGetResult` |
//! | `bool`, `int8` … `uint64`, `float32`, `float64` | `bool`, `i8` … `u64`, `f32`, `f64` |
//! | `byte`, `char` | `u8` |
//! | `string`, `wstring` | `String`, in UTF-8 and UTF-16 on the wire |
//! | `T[5]` | `[T; 5]` |
//! | `T[]`, `T[<=5]` | `Vec<T>` |
//! | the same, read in place | `my_msgs::msg::view::Wheel`: see `sm2_ros::Viewed` |
//! | a constant | an associated constant |
//! | a default value | the value of `Default` |
//! | a field whose name is a keyword, such as `type` | `r#type`; `self_`, `super_` and `crate_` |
//!
//! A type may have 128 KiB in memory, without the content of its texts and sequences, because programs put it on the
//! stack.
//!
//! The limits of `string<=5` and `T[<=5]` are checked when a message is encoded and when it is decoded.
#![forbid(unsafe_code)]

mod error;
mod field;
mod generate;
mod item;
mod names;
mod packages;
mod size;
mod value;
mod view;

use std::env;
use std::fs;
use std::path::{Path, PathBuf};

pub use error::Error;
use packages::{Package, Packages};
use sm2_ros_idl::{FolderError, Kind, Set};

/// The name of the generated file, unless the program chooses another.
const FILE_NAME: &str = "sm2_ros_types.rs";

/// The definitions of ROS 2's common interfaces, whose Rust types the crate `sm2-ros` has.
const COMMON_INTERFACES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../definitions");

/// Generates the Rust types of packages.
///
/// Definitions may refer to ROS 2's common interfaces, such as `std_msgs/Header`: their types are those of the crate
/// `sm2-ros`, which needs its feature `common-interfaces` for them.
#[derive(Clone, Debug)]
#[must_use = "a builder does nothing until generate is called"]
pub struct Builder {
    /// Folders of packages, each with the Rust module that has its types already.
    folders: Vec<(PathBuf, Option<String>)>,
    common_interfaces: bool,
    out_dir: Option<PathBuf>,
    file_name: String,
}

impl Default for Builder {
    fn default() -> Self {
        Self::new()
    }
}

impl Builder {
    /// A builder without packages.
    pub fn new() -> Self {
        Self {
            folders: Vec::new(),
            common_interfaces: true,
            out_dir: None,
            file_name: FILE_NAME.to_owned(),
        }
    }

    /// Generates the types of a package: a folder with the package's name, which has the folders `msg`, `srv` and
    /// `action`. A relative path begins at the folder of `Cargo.toml`.
    pub fn package(mut self, folder: impl Into<PathBuf>) -> Self {
        self.folders.push((folder.into(), None));
        self
    }

    /// Makes the definitions of a package known without generating its types: the Rust module `module` has them, as
    /// `module::package::msg::Type`. Such a module includes the file that another call of a builder has generated.
    pub fn external(mut self, folder: impl Into<PathBuf>, module: impl Into<String>) -> Self {
        self.folders.push((folder.into(), Some(module.into())));
        self
    }

    /// Whether definitions may refer to ROS 2's common interfaces; true by default. A [`package`](Self::package) of the
    /// same name as one of them takes its place.
    pub const fn common_interfaces(mut self, known: bool) -> Self {
        self.common_interfaces = known;
        self
    }

    /// Sets the folder of the generated file; `OUT_DIR` by default.
    pub fn out_dir(mut self, folder: impl Into<PathBuf>) -> Self {
        self.out_dir = Some(folder.into());
        self
    }

    /// Sets the name of the generated file; `sm2_ros_types.rs` by default, which `sm2_ros::include_types!` includes.
    pub fn file_name(mut self, name: impl Into<String>) -> Self {
        self.file_name = name.into();
        self
    }

    /// Generates the file, and tells cargo to run the build script again when a definition changes.
    ///
    /// # Errors
    ///
    /// See [`Error`].
    pub fn generate(&self) -> Result<(), Error> {
        for (folder, _) in &self.folders {
            println!("cargo:rerun-if-changed={}", folder.display());
        }
        let code = self.code()?;
        let from_cargo = || env::var_os("OUT_DIR").map(PathBuf::from);
        let folder = self.out_dir.clone().or_else(from_cargo);
        let path = folder.ok_or(Error::NoOutDir)?.join(&self.file_name);
        fs::write(&path, code).map_err(|error| Error::Io { path, error })
    }

    /// Returns the code that [`generate`](Self::generate) writes.
    ///
    /// # Errors
    ///
    /// See [`Error`].
    pub fn code(&self) -> Result<String, Error> {
        let (mut set, mut packages) = (Set::default(), Packages::default());
        for (folder, module) in &self.folders {
            let root = match module {
                Some(module) => Some(parse_path(module)?),
                None => None,
            };
            let name = name_of(folder);
            if packages.contains(&name) {
                return Err(Error::PackageTwice {
                    folder: folder.clone(),
                    package: name,
                });
            }
            if Kind::ALL.iter().all(|it| !folder.join(it.name()).is_dir()) {
                return Err(Error::NoDefinitions(folder.clone()));
            }
            set.add_package(folder)?;
            let folder = folder.clone();
            packages.insert(name, Package { folder, root });
        }
        if self.common_interfaces {
            add_common_interfaces(&mut set, &mut packages)?;
        }
        generate::code(&set, &packages)
    }
}

/// Adds the packages that are not there yet.
fn add_common_interfaces(set: &mut Set, packages: &mut Packages) -> Result<(), Error> {
    let root = parse_path("::sm2_ros")?;
    for folder in folders_in(Path::new(COMMON_INTERFACES))? {
        let name = name_of(&folder);
        if !packages.contains(&name) {
            set.add_package(&folder)?;
            let root = Some(root.clone());
            packages.insert(name, Package { folder, root });
        }
    }
    Ok(())
}

/// The folders in a folder, by name.
fn folders_in(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let failed = |error| FolderError::Io {
        path: folder.to_owned(),
        error,
    };
    let mut folders = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_dir() {
            folders.push(path);
        }
    }
    folders.sort();
    Ok(folders)
}

fn name_of(folder: &Path) -> String {
    let name = folder.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

fn parse_path(module: &str) -> Result<proc_macro2::TokenStream, Error> {
    match syn::parse_str::<syn::Path>(module) {
        Ok(path) => Ok(quote::quote!(#path)),
        Err(_) => Err(Error::Path(module.to_owned())),
    }
}
