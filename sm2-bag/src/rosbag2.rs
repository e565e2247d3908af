//! The description of a bag of rosbag2: `metadata.yaml` in its folder, and the same text in a metadata record of its
//! last file.
//!
//! The text is YAML, and this crate needs five scalars and one list of it. yaml-cpp and ruamel.yaml write them in block
//! style; a list in brackets on one line is understood as well.

use std::path::{Component, Path, PathBuf};

use mcap::records::Metadata;

/// The name of the description in the folder of a bag.
pub(crate) const FILE: &str = "metadata.yaml";
/// The name of the metadata record with a description, and its key.
pub(crate) const RECORD: &str = "rosbag2";
const KEY: &str = "serialized_metadata";
/// The mapping that has everything in `metadata.yaml`.
const ROOT: &str = "rosbag2_bagfile_information";
/// Up to this version, the paths begin with the name of the folder.
const LAST_VERSION_WITH_FOLDER: u64 = 3;

/// Why the description of a bag of rosbag2 is of no use.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Rosbag2Error {
    /// The description names no file.
    #[error("it names no file in relative_file_paths")]
    NoFiles,
    /// A scalar is not YAML as programs of ROS 2 write it.
    #[error("{0:?} is not text in YAML")]
    Text(String),
    /// A path leads out of the folder.
    #[error("the path {0:?} leads out of the folder")]
    Path(String),
    /// The messages are not in MCAP files.
    #[error(
        "its storage is {0:?}: `ros2 bag convert` writes a bag with the storage mcap, which SM2 reads"
    )]
    Storage(String),
    /// Messages or files are not compressed by zstd.
    #[error("it is compressed by {0:?}, and SM2 reads zstd")]
    Compression(String),
}

/// The content of a description.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Description {
    /// The paths of the files in the folder, in their order.
    pub(crate) files: Vec<PathBuf>,
    /// Whether each payload is compressed by zstd.
    pub(crate) has_packed_payloads: bool,
}

impl Description {
    /// Reads `metadata.yaml`.
    pub(crate) fn of_folder(yaml: &str) -> Result<Self, Rosbag2Error> {
        let lines = Lines::of(yaml);
        let storage = lines.scalar("storage_identifier")?;
        if !matches!(storage.as_str(), "" | "mcap") {
            return Err(Rosbag2Error::Storage(storage));
        }
        let has_packed_payloads = lines.has_packed_payloads()?;
        let version = lines.scalar("version")?.parse().unwrap_or(u64::MAX);
        let mut files = Vec::new();
        for path in lines.list("relative_file_paths")? {
            let mut below = Path::new(&path);
            if version <= LAST_VERSION_WITH_FOLDER {
                let mut components = below.components();
                components.next();
                below = components.as_path();
            }
            let is_below = |it: Component<'_>| matches!(it, Component::Normal(_));
            if below.as_os_str().is_empty() || !below.components().all(is_below) {
                return Err(Rosbag2Error::Path(path));
            }
            files.push(below.to_owned());
        }
        match files.is_empty() {
            true => Err(Rosbag2Error::NoFiles),
            false => Ok(Self {
                files,
                has_packed_payloads,
            }),
        }
    }
}

/// Whether a file with these metadata records says that each payload is compressed by zstd.
pub(crate) fn has_packed_payloads(metadata: &[Metadata]) -> bool {
    let descriptions = metadata.iter().filter(|it| it.name == RECORD);
    // A program may write one at the beginning, and the whole one at the end.
    let last = descriptions
        .filter_map(|it| it.metadata.get(KEY))
        .next_back();
    last.is_some_and(|it| Lines::of(it).has_packed_payloads() == Ok(true))
}

/// The lines of a description.
struct Lines<'a> {
    lines: Vec<&'a str>,
    /// The indentation of its keys.
    indent: usize,
}

impl<'a> Lines<'a> {
    fn of(yaml: &'a str) -> Self {
        let is_content = |line: &&str| {
            let line = line.trim();
            !line.is_empty() && !line.starts_with('#') && !matches!(line, "---" | "...")
        };
        let mut lines: Vec<_> = yaml.lines().filter(is_content).collect();
        if lines.first().is_some_and(|it| it.starts_with(ROOT)) {
            lines.remove(0);
        }
        let indent = lines.first().map_or(0, |it| indent(it));
        Self { lines, indent }
    }

    /// The text behind a key, and the lines that belong to it.
    fn value(&self, key: &str) -> Option<(&'a str, &[&'a str])> {
        let behind = |line: &&'a str| {
            let rest = line.trim_start().strip_prefix(key)?.trim_start();
            rest.strip_prefix(':')
        };
        let is_key = |line: &&'a str| indent(line) == self.indent && behind(line).is_some();
        let at = self.lines.iter().position(is_key)?;
        let below = &self.lines[at + 1..];
        // The items of a list may stand as far left as their key.
        let belongs = |line: &&'a str| {
            indent(line) > self.indent
                || indent(line) == self.indent && line.trim_start().starts_with('-')
        };
        let end = below.iter().position(|it| !belongs(it));
        Some((
            behind(&self.lines[at])?.trim(),
            &below[..end.unwrap_or(below.len())],
        ))
    }

    /// The scalar of a key; empty if it is not there.
    fn scalar(&self, key: &str) -> Result<String, Rosbag2Error> {
        match self.value(key) {
            None => Ok(String::new()),
            // A long one stands on the next line.
            Some(("", [next, ..])) => scalar(next),
            Some((text, _)) => scalar(text),
        }
    }

    /// The list of a key; empty if it is not there.
    fn list(&self, key: &str) -> Result<Vec<String>, Rosbag2Error> {
        let Some((text, below)) = self.value(key) else {
            return Ok(Vec::new());
        };
        if let Some(items) = text.strip_prefix('[').and_then(|it| it.strip_suffix(']')) {
            let items = items.split(',').filter(|it| !it.trim().is_empty());
            return items.map(scalar).collect();
        }
        let mut items = Vec::new();
        let mut below = below.iter().peekable();
        while let Some(line) = below.next() {
            let Some(item) = line.trim_start().strip_prefix('-') else {
                return Err(Rosbag2Error::Text((*line).to_owned()));
            };
            // A long one stands on the next line.
            let item = match item.trim() {
                "" => below.next().copied().unwrap_or_default(),
                item => item,
            };
            items.push(scalar(item)?);
        }
        Ok(items)
    }

    fn has_packed_payloads(&self) -> Result<bool, Rosbag2Error> {
        let mode = self.scalar("compression_mode")?;
        let format = self.scalar("compression_format")?;
        let is_packed = mode.eq_ignore_ascii_case("message");
        match format.as_str() {
            "zstd" => Ok(is_packed),
            _ if is_packed || mode.eq_ignore_ascii_case("file") => {
                Err(Rosbag2Error::Compression(format))
            }
            _ => Ok(false),
        }
    }
}

fn indent(line: &str) -> usize {
    line.len() - line.trim_start_matches(' ').len()
}

/// Reads a scalar: plain, or in quotation marks.
fn scalar(text: &str) -> Result<String, Rosbag2Error> {
    let text = text.trim();
    let wrong = || Rosbag2Error::Text(text.to_owned());
    if let Some(rest) = text.strip_prefix('\'') {
        let (inner, _) = rest.rsplit_once('\'').ok_or_else(wrong)?;
        return Ok(inner.replace("''", "'"));
    }
    let Some(rest) = text.strip_prefix('"') else {
        // A comment begins behind a space.
        let plain = text.split_once(" #").map_or(text, |(plain, _)| plain);
        return Ok(plain.trim_end().to_owned());
    };
    let mut scalar = String::new();
    let mut rest = rest.chars();
    loop {
        match rest.next().ok_or_else(wrong)? {
            '"' => return Ok(scalar),
            '\\' => match rest.next() {
                Some(it @ ('"' | '\\' | '/')) => scalar.push(it),
                Some(kind @ ('x' | 'u' | 'U')) => {
                    let digits = if kind == 'x' {
                        2
                    } else if kind == 'u' {
                        4
                    } else {
                        8
                    };
                    let code: String = rest.by_ref().take(digits).collect();
                    let code = u32::from_str_radix(&code, 16).ok();
                    scalar.push(code.and_then(char::from_u32).ok_or_else(wrong)?);
                }
                _ => return Err(wrong()),
            },
            it => scalar.push(it),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(yaml: &str) -> Result<Vec<String>, Rosbag2Error> {
        let description = Description::of_folder(yaml)?;
        let files = description.files.iter();
        Ok(files.map(|it| it.display().to_string()).collect())
    }

    /// As yaml-cpp writes it in a recorder of ROS 2, and ruamel.yaml in `rosbags`.
    #[test]
    fn both_writers_are_understood() {
        let cpp = "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n  duration:\n    \
            nanoseconds: 5\n  topics_with_message_count:\n    - topic_metadata:\n        name: /a\n        \
            compression_mode: message\n  compression_format: \"\"\n  compression_mode: \"\"\n  \
            relative_file_paths:\n    - drive_0.mcap\n    - drive_1.mcap\n  files:\n    - path: drive_0.mcap\n";
        assert_eq!(files(cpp).unwrap(), ["drive_0.mcap", "drive_1.mcap"]);
        let ruamel = "rosbag2_bagfile_information:\n  compression_format: zstd\n  compression_mode: message\n  \
            custom_data:\n  files:\n  - duration:\n      nanoseconds: 0\n    path: a.mcap\n  relative_file_paths:\n  \
            -\n    a_very_long_name.mcap\n  - 'it''s.mcap'\n  - \"\\x61\\u00e9.mcap\"\n  storage_identifier: mcap\n  \
            version: 8\n";
        let description = Description::of_folder(ruamel).unwrap();
        assert!(description.has_packed_payloads);
        let expected = ["a_very_long_name.mcap", "it's.mcap", "aé.mcap"];
        assert_eq!(files(ruamel).unwrap(), expected);
        // Without the root, as in a metadata record; by hand.
        let flat = "# by hand\nrelative_file_paths: [a.mcap, \"b.mcap\"] \nversion: 9\ncompression_mode: FILE\n\
            compression_format: zstd # always\n";
        assert_eq!(files(flat).unwrap(), ["a.mcap", "b.mcap"]);
        assert!(!Description::of_folder(flat).unwrap().has_packed_payloads);
        // An early version names the folder.
        let early = "version: 3\nrelative_file_paths:\n- drive/drive_0.mcap\n";
        assert_eq!(files(early).unwrap(), ["drive_0.mcap"]);
    }

    #[test]
    fn a_description_that_is_of_no_use_says_why() {
        let path = |text: &str| Rosbag2Error::Path(text.to_owned());
        let list = |item: &str| format!("relative_file_paths:\n- {item}\n");
        for (yaml, error) in [
            (String::new(), Rosbag2Error::NoFiles),
            (list("../a.mcap"), path("../a.mcap")),
            (list("/a.mcap"), path("/a.mcap")),
            (list("\"\""), path("")),
            (list("\"\\q\""), Rosbag2Error::Text("\"\\q\"".to_owned())),
            (list("'a"), Rosbag2Error::Text("'a".to_owned())),
            (
                "storage_identifier: sqlite3\n".to_owned(),
                Rosbag2Error::Storage("sqlite3".to_owned()),
            ),
            (
                "compression_mode: MESSAGE\ncompression_format: lz4\n".to_owned(),
                Rosbag2Error::Compression("lz4".to_owned()),
            ),
        ] {
            assert_eq!(files(&yaml), Err(error), "{yaml}");
        }
    }

    #[test]
    fn the_last_record_of_a_file_counts() {
        let record = |mode: &str| Metadata {
            name: RECORD.to_owned(),
            metadata: [(
                KEY.to_owned(),
                format!("compression_format: zstd\ncompression_mode: {mode}"),
            )]
            .into(),
        };
        assert!(!has_packed_payloads(&[]));
        assert!(has_packed_payloads(&[record("none"), record("message")]));
        assert!(!has_packed_payloads(&[record("message"), record("")]));
    }
}
