use super::*;

fn names(path: &Path) -> Vec<String> {
    let entries = fs::read_dir(path).unwrap();
    let mut names: Vec<_> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort_unstable();
    names
}

#[test]
fn messages_become_numbered_files() {
    let parent = tempfile::tempdir().unwrap();
    let path = parent.path().join("new/folder");
    let mut folder = Folder::open(&path).unwrap();
    for message in [&b"one"[..], b"", &[0, 255]] {
        let file = folder.store(message).unwrap();
        assert_eq!(fs::read(file).unwrap(), message);
    }
    assert_eq!(names(&path), ["000000.bin", "000001.bin", "000002.bin"]);
}

#[test]
fn messages_of_an_earlier_run_are_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("notes.bin"), "").unwrap();
    fs::write(folder.path().join("00001.bin"), "").unwrap();
    Folder::open(folder.path()).unwrap();
    fs::write(folder.path().join("000007.bin"), "old").unwrap();
    let error = Folder::open(folder.path()).unwrap_err();
    assert!(error.to_string().contains("000007.bin"), "{error}");
}

#[test]
fn a_message_that_cannot_be_written_leaves_nothing() {
    let parent = tempfile::tempdir().unwrap();
    let path = parent.path().join("folder");
    let mut folder = Folder::open(&path).unwrap();
    // A folder in place of the file makes the rename fail, even for root.
    fs::create_dir(path.join("000000.bin")).unwrap();
    let error = folder.store(b"message").unwrap_err();
    assert!(error.to_string().starts_with("cannot write "), "{error}");
    assert_eq!(names(&path), ["000000.bin"]);
    fs::remove_dir(path.join("000000.bin")).unwrap();
    folder.store(b"message").unwrap();
    assert_eq!(names(&path), ["000000.bin"]);
}

#[test]
fn a_file_is_no_folder() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let error = Folder::open(file.path()).unwrap_err();
    assert!(
        error.to_string().starts_with("cannot create folder "),
        "{error}"
    );
}
