//! Folders of definitions.

use std::fs;
use std::path::Path;

use sm2_ros_idl::{FolderError, Set};

fn write(path: &Path, text: &[u8]) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

/// The names of the types that are not parts of a service or action.
fn names(set: &Set) -> Vec<String> {
    let names = set.types().map(|it| it.name.to_string());
    names.filter(|it| !it.contains('_')).collect()
}

/// A folder with the packages `p` and `q`, and with files that are not definitions.
fn packages() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (file, text) in [
        ("p/msg/T.msg", "int8 a\n"),
        ("p/msg/README.md", "Not a definition.\n"),
        ("p/msg/Other.srv", "---\n"),
        ("p/srv/S.srv", "int8 a\n---\nint8 b\n"),
        ("p/action/A.action", "---\n---\n"),
        ("p/cmake/T.msg", "not a definition\n"),
        ("q/msg/U.msg", "p/T t\n"),
        ("README.md", "Not a package.\n"),
    ] {
        write(&folder.path().join(file), text.as_bytes());
    }
    folder
}

const OF_P: [&str; 3] = ["p/action/A", "p/msg/T", "p/srv/S"];

#[test]
fn a_package_has_the_files_of_its_three_folders() {
    let folder = packages();
    let mut set = Set::default();
    set.add_package(&folder.path().join("p")).unwrap();
    assert_eq!(names(&set), OF_P);
}

#[test]
fn definitions_are_a_package_or_a_folder_of_packages() {
    let folder = packages();
    let mut set = Set::default();
    set.add_definitions(&folder.path().join("p")).unwrap();
    assert_eq!(names(&set), OF_P);
    let all = [&OF_P[..], &["q/msg/U"]].concat();
    let mut set = Set::default();
    set.add_definitions(folder.path()).unwrap();
    assert_eq!(names(&set), all);
    let mut set = Set::default();
    set.add_folder(folder.path()).unwrap();
    assert_eq!(names(&set), all);
}

#[test]
fn an_error_names_its_file() {
    let folder = packages();
    let path = |file: &str| folder.path().join(file);
    let error = || Set::default().add_folder(folder.path()).unwrap_err();

    write(&path("q/msg/V.msg"), b"int8 a\nint8\n");
    match error() {
        FolderError::Definition { path: at, error } => {
            assert_eq!((at, error.line), (path("q/msg/V.msg"), 2));
        }
        other => panic!("{other}"),
    }
    fs::remove_file(path("q/msg/V.msg")).unwrap();

    write(&path("q/msg/V-W.msg"), b"int8 a\n");
    assert!(matches!(error(), FolderError::Name { path: at, .. } if at == path("q/msg/V-W.msg")));
    fs::remove_file(path("q/msg/V-W.msg")).unwrap();

    write(&path("q/msg/V.msg"), b"# \xff\n");
    assert!(matches!(error(), FolderError::Io { path: at, .. } if at == path("q/msg/V.msg")));

    let missing = path("missing");
    for added in [
        Set::default().add_folder(&missing),
        Set::default().add_definitions(&missing),
    ] {
        let error = added.unwrap_err();
        assert!(
            matches!(&error, FolderError::Io { path, .. } if *path == missing),
            "{error}"
        );
    }
}
