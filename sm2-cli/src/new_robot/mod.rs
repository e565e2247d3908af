//! `sm2 new`: a folder with the Cargo workspace of a small robot.
//!
//! The files are those of `template/`. Cargo would take a `Cargo.toml` there for a package of this repository, so they
//! have other names.

mod error;

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use clap::Args;

pub(crate) use self::error::NewError;
use crate::{ended::Ended, error::CliError, output::Output};

/// `sm2 new`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// The robot: a new folder of this name is made here
    #[arg(value_name = "NAME", value_parser = name)]
    name: String,
    /// Use the libraries of this clone of SM2's repository, not those of crates.io
    #[arg(long, value_name = "PATH")]
    sm2_path: Option<PathBuf>,
}

const HELP: &str = "\
The folder has two nodes in Rust (lidar and driver), their parameters, a robot.toml for `sm2 up`, a
test, and a README. An existing folder is never changed. Nothing is released on crates.io yet, so the
robot does not build without --sm2-path.

Exit status: 0 made, 1 failed, 2 wrong usage.

Examples:
  sm2 new robot --sm2-path ~/sm2
  sm2 new robot";

/// The longest name.
const NAME_MAX: usize = 64;

/// The files, with their paths in the folder.
const FILES: [(&str, &str); 9] = [
    (".gitignore", include_str!("template/gitignore")),
    ("README.md", include_str!("template/README.md")),
    ("robot.toml", include_str!("template/robot.toml")),
    ("params.toml", include_str!("template/params.toml")),
    ("lidar/Cargo.toml", include_str!("template/lidar.toml")),
    ("lidar/src/main.rs", include_str!("template/lidar.rs")),
    ("driver/Cargo.toml", include_str!("template/driver.toml")),
    ("driver/src/main.rs", include_str!("template/driver.rs")),
    (
        "driver/tests/driver.rs",
        include_str!("template/driver_test.rs"),
    ),
];

/// The manifest of the workspace, without its dependencies.
const WORKSPACE: &str = include_str!("template/workspace.toml");

/// The library that the nodes and the test use.
const LIBRARY: &str = "sm2-node";

/// Parses the name of a robot.
fn name(text: &str) -> Result<String, String> {
    let is_part = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-');
    let begins = text.starts_with(|c: char| c.is_ascii_alphabetic());
    match begins && text.len() <= NAME_MAX && text.chars().all(is_part) {
        true => Ok(text.to_owned()),
        false => {
            Err("a name has 1 to 64 characters of A-Z a-z 0-9 _ -, the first one a letter".into())
        }
    }
}

/// Makes the folder.
///
/// # Errors
///
/// [`NewError`], [`CliError::File`], [`CliError::Output`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let manifest = manifest(arguments.sm2_path.as_deref())?;
    let folder = Path::new(&arguments.name);
    fs::create_dir(folder).map_err(|source| match source.kind() {
        io::ErrorKind::AlreadyExists => NewError::Exists(folder.to_owned()).into(),
        _ => CliError::file("make", folder, source),
    })?;
    let files = FILES
        .iter()
        .map(|(path, text)| (*path, text.replace("NAME", &arguments.name)));
    let written = files
        .chain([("Cargo.toml", manifest)])
        .try_for_each(|(path, text)| write(&folder.join(path), &text));
    if written.is_err() {
        // The folder is new, so nothing of somebody else is in it.
        let _ = fs::remove_dir_all(folder);
    }
    written?;
    let mut out = Output::new();
    out.line(format_args!(
        "made {0}: cd {0}, cargo build --release, sm2 up",
        arguments.name
    ))?;
    Ok(Ended::Done)
}

fn write(path: &Path, text: &str) -> Result<(), CliError> {
    let parent = path.parent().map_or(Ok(()), fs::create_dir_all);
    let written = parent.and_then(|()| fs::write(path, text));
    written.map_err(|error| CliError::file("write", path, error))
}

/// The manifest of the workspace.
fn manifest(sm2: Option<&Path>) -> Result<String, CliError> {
    let version = env!("CARGO_PKG_VERSION");
    let mut text = WORKSPACE.to_owned();
    let sm2 = match sm2 {
        None => None,
        Some(path) => {
            let full =
                fs::canonicalize(path).map_err(|error| CliError::file("find", path, error))?;
            if !full.join("sm2-node/Cargo.toml").is_file() {
                return Err(NewError::NotSm2(full).into());
            }
            Some(full)
        }
    };
    let path = match &sm2 {
        None => String::new(),
        Some(sm2) => {
            let path = sm2.join(LIBRARY);
            let path = path
                .to_str()
                .ok_or_else(|| NewError::NotText(sm2.clone()))?;
            // A string of JSON is one of TOML.
            format!(", path = {}", serde_json::Value::from(path))
        }
    };
    text += &format!("{LIBRARY} = {{ version = \"{version}\"{path} }}\n");
    Ok(text)
}
