//! A bag that has several files.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::bag::Bag;
use crate::error::ReadError;
use crate::observer::Observer;
use crate::rosbag2::{self, Description};

/// The longest description that is read, in bytes.
const DESCRIPTION_MAX_BYTES: u64 = 64 << 20;
/// How the name of a file with messages ends, and of one that is compressed as a whole.
const ENDINGS: [&str; 3] = [".mcap", ".mcap.zst", ".mcap.zstd"];
/// The ending that a recorder of ROS 2 adds to the name of a file that it compresses.
const PACKED_ENDING: &str = "zstd";

/// The files of a bag: one file, or those of a folder.
///
/// A folder with the `metadata.yaml` of rosbag2 has the files that this names, in their order. Any other folder has all
/// files that end in `.mcap`, `.mcap.zst` or `.mcap.zstd`, in the order of their names, such as those of a recording
/// that was split.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagFiles {
    paths: Vec<PathBuf>,
    /// Whether the description says that each payload is compressed.
    has_packed_payloads: bool,
}

impl BagFiles {
    /// Finds the files of the bag `path`.
    ///
    /// # Errors
    ///
    /// [`ReadError::Io`], [`ReadError::Rosbag2`], [`ReadError::NoBag`] for a folder without a bag.
    pub fn find(path: &Path) -> Result<Self, ReadError> {
        if !path.is_dir() {
            return Ok(Self {
                paths: vec![path.to_owned()],
                has_packed_payloads: false,
            });
        }
        if let Some(files) = Self::described(path)? {
            return Ok(files);
        }
        let paths = bags_in(path).map_err(failed(path))?;
        match paths.is_empty() {
            true => Err(ReadError::NoBag { path: path.into() }),
            false => Ok(Self {
                paths,
                has_packed_payloads: false,
            }),
        }
    }

    /// The files that a folder has by its description; `None` without one.
    fn described(folder: &Path) -> Result<Option<Self>, ReadError> {
        let path = folder.join(rosbag2::FILE);
        let mut yaml = String::new();
        let read = File::open(&path).and_then(|file| {
            let mut file = file.take(DESCRIPTION_MAX_BYTES);
            file.read_to_string(&mut yaml)
        });
        match read {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            read => read.map_err(failed(&path))?,
        };
        let description = Description::of_folder(&yaml);
        let description = description.map_err(|reason| ReadError::Rosbag2 { path, reason })?;
        let paths = description.files.iter();
        let paths = paths.map(|it| present(folder.join(it))).collect();
        Ok(Some(Self {
            paths,
            has_packed_payloads: description.has_packed_payloads,
        }))
    }

    /// The paths, in the order of the files.
    #[must_use]
    pub fn paths(&self) -> &[PathBuf] {
        &self.paths
    }

    /// Whether each payload is compressed, as rosbag2 can do it.
    pub(crate) const fn has_packed_payloads(&self) -> bool {
        self.has_packed_payloads
    }

    /// Whether this is one file, and everything that has to be known of it stands in it.
    pub(crate) const fn is_one(&self) -> bool {
        self.paths.len() == 1 && !self.has_packed_payloads
    }

    /// Opens the files. The observer is told about the chunks of those without a summary.
    ///
    /// # Errors
    ///
    /// [`ReadError`].
    pub fn open(&self, observer: &mut Observer<'_>) -> Result<Vec<Bag>, ReadError> {
        let bags = self.paths.iter().map(|path| {
            let bag = Bag::open_observed(path, observer)?;
            Ok(match self.has_packed_payloads {
                true => bag.with_packed_payloads(),
                false => bag,
            })
        });
        bags.collect()
    }
}

/// The bags that are single files in a folder, sorted by their names.
///
/// # Errors
///
/// Any error of reading the folder.
pub fn bags_in(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if ENDINGS.iter().any(|it| name.ends_with(it)) && path.is_file() {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// A player of ROS 2 leaves the decompressed file beside the compressed one, which may be gone then.
fn present(path: PathBuf) -> PathBuf {
    let is_packed = path.extension().is_some_and(|it| it == PACKED_ENDING);
    let unpacked = path.with_extension("");
    match is_packed && !path.exists() && unpacked.exists() {
        true => unpacked,
        false => path,
    }
}

fn failed(path: &Path) -> impl FnOnce(io::Error) -> ReadError {
    let path = path.to_owned();
    |source| ReadError::Io { path, source }
}
