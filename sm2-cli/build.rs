//! Embeds the definitions of ROS 2's common interfaces: a table of their names and texts.

use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::{env, fs, io};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = fs::canonicalize("../sm2-ros/definitions")?;
    println!("cargo:rerun-if-changed={}", folder.display());
    let mut table = String::from("&[\n");
    for package in folders(&folder)? {
        for kind in folders(&package)? {
            for file in entries(&kind)? {
                let name = file.strip_prefix(&folder)?.with_extension("");
                let (name, file) = (name.display().to_string(), file.display().to_string());
                writeln!(table, "    ({name:?}, include_str!({file:?})),")?;
            }
        }
    }
    table.push_str("]\n");
    let out = Path::new(&env::var("OUT_DIR")?).join("common_interfaces.rs");
    Ok(fs::write(out, table)?)
}

fn folders(folder: &Path) -> io::Result<Vec<PathBuf>> {
    Ok(entries(folder)?
        .into_iter()
        .filter(|it| it.is_dir())
        .collect())
}

/// The content of a folder, by name, so that each build has the same table.
fn entries(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder)?.map(|it| it.map(|entry| entry.path()));
    let mut paths = entries.collect::<io::Result<Vec<_>>>()?;
    paths.sort();
    Ok(paths)
}
