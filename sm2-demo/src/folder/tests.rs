use std::{fs::FileTimes, os::unix::fs::symlink, time::SystemTime};

use super::*;

/// A folder with these files, of this age.
fn make(parent: &Path, name: &str, files: &[&str], age: Duration) -> PathBuf {
    let folder = parent.join(name);
    fs::create_dir(&folder).unwrap();
    for file in files {
        fs::write(folder.join(file), "").unwrap();
    }
    let times = FileTimes::new().set_modified(SystemTime::now() - age);
    File::open(&folder).unwrap().set_times(times).unwrap();
    folder
}

#[test]
fn a_long_path_leaves_no_room_for_that_of_the_socket() {
    let long = |len| PathBuf::from(format!("/{}", "x".repeat(len - 1)));
    assert_eq!(parent(long(PARENT_MAX_BYTES)), long(PARENT_MAX_BYTES));
    assert_eq!(parent(long(PARENT_MAX_BYTES + 1)), Path::new("/tmp"));
}

#[test]
fn only_folders_of_dead_demos_are_removed() {
    let parent = tempfile::tempdir().unwrap();
    let parent = parent.path();
    let old = 2 * MIN_AGE;
    make(parent, "sm2-demo-dead", &[LOCK, SOCKET], old);
    make(parent, "sm2-demo-never-alive", &[], old);
    // Alive, about to be, or none of ours.
    let alive = make(parent, "sm2-demo-alive", &[LOCK, SOCKET], old).join(LOCK);
    let lock = Flock::lock(File::open(&alive).unwrap(), FlockArg::LockExclusive).unwrap();
    make(parent, "sm2-demo-starts", &[], Duration::ZERO);
    make(parent, "sm2-demo-locks", &[LOCK], Duration::ZERO);
    let other = make(parent, "other", &[LOCK], old);
    symlink(other, parent.join("sm2-demo-link")).unwrap();

    remove_leftovers(parent);
    let left = fs::read_dir(parent).unwrap();
    let mut left: Vec<_> = left.map(|it| it.unwrap().file_name()).collect();
    left.sort_unstable();
    let expected = [
        "other",
        "sm2-demo-alive",
        "sm2-demo-link",
        "sm2-demo-locks",
        "sm2-demo-starts",
    ];
    assert_eq!(left, expected);
    drop(lock);
}

/// Nobody else may remove them, and a lock that cannot be opened may be held.
#[test]
fn folders_of_others_and_those_in_doubt_are_left_alone() {
    let parent = tempfile::tempdir().unwrap();
    let old = 2 * MIN_AGE;
    let doubt = make(parent.path(), "sm2-demo-doubt", &[], old);
    symlink(LOCK, doubt.join(LOCK)).unwrap();
    // The link has changed the time.
    let times = FileTimes::new().set_modified(SystemTime::now() - old);
    File::open(&doubt).unwrap().set_times(times).unwrap();
    let other = make(parent.path(), "sm2-demo-other", &[LOCK], old);
    let is_root = std::os::unix::fs::chown(&other, Some(geteuid().as_raw() + 1), None).is_ok();

    remove_leftovers(parent.path());
    assert!(doubt.exists());
    assert_eq!(other.exists(), is_root);
}
