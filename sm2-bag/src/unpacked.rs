//! Files that are compressed as a whole: `.mcap.zst`, or `.mcap.zstd` as rosbag2 names them.
//!
//! Messages are read in the order of their times, and a summary is at the end. So the content goes to a temporary file
//! without a name, which the system removes when it is closed.

use std::env;
use std::ffi::OsStr;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufReader, Read, Write};
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use nix::errno::Errno;
use nix::fcntl::OFlag;

use crate::error::ReadError;
use crate::observer::{Observer, report_progress};
use crate::storage::FreeBytes;

/// The first bytes of a file that zstd wrote.
const MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
/// The part of the content that is in memory, in bytes.
const PART_BYTES: usize = 1 << 20;
/// So many bytes of the disk are left to others.
const MIN_FREE_BYTES: u64 = 64 << 20;
/// The variable with the folder for temporary files.
const FOLDER: &str = "TMPDIR";

/// Whether a file is compressed as a whole.
pub(crate) fn is_packed(file: &File) -> bool {
    let mut magic = [0; MAGIC.len()];
    file.read_exact_at(&mut magic, 0).is_ok() && magic == MAGIC
}

/// The content of the compressed file `packed` of this path. If its end is missing, the content ends there.
/// `free_bytes` says how much room a disk has.
pub(crate) fn unpack(
    path: &Path,
    packed: &File,
    free_bytes: FreeBytes,
    observer: &mut Observer<'_>,
) -> Result<File, ReadError> {
    let failed = |source| ReadError::Io {
        path: path.to_owned(),
        source,
    };
    let (folder, mut unpacked) = create(path).map_err(failed)?;
    let no_room = || ReadError::NoRoom {
        path: path.to_owned(),
        folder: folder.clone(),
    };
    let mut content = zstd::Decoder::with_buffer(BufReader::new(packed)).map_err(failed)?;
    let mut part = vec![0; PART_BYTES];
    loop {
        let len = match content.read(&mut part) {
            Ok(0) => return Ok(unpacked),
            Ok(len) => len,
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
                tracing::warn!(path = %path.display(), "the end of the compressed file is missing");
                return Ok(unpacked);
            }
            Err(error) => return Err(failed(error)),
        };
        let free = free_bytes(&unpacked).map_err(failed)?;
        if free < MIN_FREE_BYTES + len as u64 {
            return Err(no_room());
        }
        match unpacked.write_all(&part[..len]) {
            Err(error) if is_full(&error) => return Err(no_room()),
            written => written.map_err(failed)?,
        }
        report_progress(observer, 0)?;
    }
}

/// Whether a file system, or the part of a user, has no room.
fn is_full(error: &io::Error) -> bool {
    let errors = [Errno::ENOSPC, Errno::EDQUOT, Errno::EFBIG];
    errors
        .iter()
        .any(|it| error.raw_os_error() == Some(*it as i32))
}

/// Creates a file without a name: in the folder that the user has set, or else beside the bag, or else where the system
/// has such files. Returns the folder as well.
fn create(path: &Path) -> io::Result<(PathBuf, File)> {
    let set = env::var_os(FOLDER).filter(|it| !it.is_empty());
    if let Some(folder) = set.map(PathBuf::from) {
        let file = create_in(&folder)?;
        return Ok((folder, file));
    }
    let beside = match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    if let Ok(file) = create_in(beside) {
        return Ok((beside.to_owned(), file));
    }
    let folder = env::temp_dir();
    let file = create_in(&folder)?;
    Ok((folder, file))
}

fn create_in(folder: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.read(true).write(true).mode(0o600);
    let flags = OFlag::O_TMPFILE.bits();
    match options.clone().custom_flags(flags).open(folder) {
        Ok(file) => Ok(file),
        // Not every file system has files without a name.
        Err(_) => {
            let name = format!(".sm2-unpacked-{}", std::process::id());
            let path = folder.join(OsStr::new(&name));
            let file = options.create_new(true).open(&path)?;
            fs::remove_file(&path)?;
            Ok(file)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observer::unobserved;

    fn packed(content: &[u8]) -> File {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(&zstd::encode_all(content, 0).unwrap())
            .unwrap();
        file.sync_data().unwrap();
        io::Seek::rewind(&mut file).unwrap();
        file
    }

    fn unpacked(packed: &File, free_bytes: FreeBytes) -> Result<Vec<u8>, ReadError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bag.mcap.zst");
        let file = unpack(&path, packed, free_bytes, &mut unobserved)?;
        // The file has no name.
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        let mut content = vec![0; file.metadata().unwrap().len() as usize];
        file.read_exact_at(&mut content, 0).unwrap();
        Ok(content)
    }

    fn much(_: &File) -> io::Result<u64> {
        Ok(u64::MAX)
    }

    #[test]
    fn a_content_is_unpacked_as_far_as_it_goes() {
        let content: Vec<_> = (0..3 * PART_BYTES).map(|it| (it / 3) as u8).collect();
        let whole = packed(&content);
        assert!(is_packed(&whole));
        assert!(unpacked(&whole, much).unwrap() == content);
        let end = whole.metadata().unwrap().len();
        whole.set_len(end - 20).unwrap();
        io::Seek::rewind(&mut (&whole)).unwrap();
        let torn = unpacked(&whole, much).unwrap();
        assert!(torn.len() < content.len() && content.starts_with(&torn));
    }

    #[test]
    fn a_disk_is_not_filled() {
        let few = |_: &File| Ok(MIN_FREE_BYTES);
        let error = unpacked(&packed(b"content"), few).unwrap_err();
        assert!(matches!(error, ReadError::NoRoom { .. }), "{error}");
        assert!(error.to_string().contains(FOLDER), "{error}");
    }
}
