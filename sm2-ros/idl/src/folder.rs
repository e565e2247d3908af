//! Folders of definitions: `package/msg/Name.msg`, as ROS 2 installs them below `share`.

use std::fs;
use std::path::{Path, PathBuf};

use crate::{FolderError, Kind, Set, TypeName};

impl Set {
    /// Adds all definitions of one package, whose folder has the package's name.
    ///
    /// # Errors
    ///
    /// [`FolderError`] with the path that is wrong.
    pub fn add_package(&mut self, folder: &Path) -> Result<(), FolderError> {
        let package = folder.file_name().unwrap_or_default().to_string_lossy();
        for kind in Kind::ALL {
            let folder = folder.join(kind.name());
            if !folder.is_dir() {
                continue;
            }
            for path in entries(&folder)? {
                if path.extension().is_none_or(|it| it != kind.name()) {
                    continue;
                }
                let stem = path.file_stem().unwrap_or_default().to_string_lossy();
                let name = match TypeName::new(&package, kind, &stem) {
                    Ok(name) => name,
                    Err(error) => return Err(FolderError::Name { path, error }),
                };
                let text = match fs::read_to_string(&path) {
                    Ok(text) => text,
                    Err(error) => return Err(FolderError::Io { path, error }),
                };
                if let Err(error) = self.add(&name, &text) {
                    return Err(FolderError::Definition { path, error });
                }
            }
        }
        Ok(())
    }

    /// Adds the definitions of a package (`FOLDER/msg/Name.msg`), or of all packages whose folders are in this one.
    ///
    /// # Errors
    ///
    /// [`FolderError`] with the path that is wrong.
    pub fn add_definitions(&mut self, folder: &Path) -> Result<(), FolderError> {
        if !Kind::ALL.iter().any(|it| folder.join(it.name()).is_dir()) {
            return self.add_folder(folder);
        }
        // The name of a package is that of its folder, which `.` lacks.
        match std::path::absolute(folder) {
            Ok(folder) => self.add_package(&folder),
            Err(error) => Err(FolderError::Io {
                path: folder.to_owned(),
                error,
            }),
        }
    }

    /// Adds the packages whose folders are in this one, such as `/opt/ros/jazzy/share`.
    ///
    /// # Errors
    ///
    /// [`FolderError`] with the path that is wrong.
    pub fn add_folder(&mut self, folder: &Path) -> Result<(), FolderError> {
        for path in entries(folder)? {
            if path.is_dir() {
                self.add_package(&path)?;
            }
        }
        Ok(())
    }
}

/// The content of a folder, by name.
fn entries(folder: &Path) -> Result<Vec<PathBuf>, FolderError> {
    let entries = fs::read_dir(folder).and_then(|it| {
        it.map(|entry| entry.map(|it| it.path()))
            .collect::<Result<Vec<_>, _>>()
    });
    let mut paths = entries.map_err(|error| FolderError::Io {
        path: folder.to_owned(),
        error,
    })?;
    paths.sort();
    Ok(paths)
}
