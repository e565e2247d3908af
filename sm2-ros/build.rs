//! Generates the types of ROS 2's common interfaces (feature `common-interfaces`), and a table of the names and texts
//! of their definitions (feature `definitions`).

use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=definitions");
    #[cfg(feature = "definitions")]
    table::write()?;
    #[cfg(feature = "common-interfaces")]
    generate()?;
    Ok(())
}

#[cfg(feature = "common-interfaces")]
fn generate() -> Result<(), Box<dyn Error>> {
    let mut builder = sm2_ros_build::Builder::new().common_interfaces(false);
    for entry in std::fs::read_dir("definitions")? {
        let path = entry?.path();
        if path.is_dir() {
            builder = builder.package(path);
        }
    }
    Ok(builder.generate()?)
}

#[cfg(feature = "definitions")]
mod table {
    use std::error::Error;
    use std::fmt::Write as _;
    use std::path::{Path, PathBuf};
    use std::{env, fs, io};

    pub(super) fn write() -> Result<(), Box<dyn Error>> {
        let folder = fs::canonicalize("definitions")?;
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
        let entries = entries(folder)?.into_iter();
        Ok(entries.filter(|it| it.is_dir()).collect())
    }

    /// The content of a folder, by name, so that each build has the same table.
    fn entries(folder: &Path) -> io::Result<Vec<PathBuf>> {
        let entries = fs::read_dir(folder)?.map(|it| it.map(|entry| entry.path()));
        let mut paths = entries.collect::<io::Result<Vec<_>>>()?;
        paths.sort();
        Ok(paths)
    }
}
