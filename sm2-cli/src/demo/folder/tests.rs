use std::fs::FileTimes;

use super::*;

fn is_there(parent: &Path, name: &str) -> bool {
    fs::symlink_metadata(parent.join(name)).is_ok()
}

#[test]
fn only_folders_of_dead_demos_are_removed() {
    let parent = tempfile::tempdir().unwrap();
    let make = |name: &str| {
        let folder = parent.path().join(name);
        fs::create_dir(&folder).unwrap();
        folder
    };
    // Dead: a lock that nobody holds, or no lock for a long time.
    fs::write(make("sm2-demo-dead").join(LOCK), "").unwrap();
    let old = make("sm2-demo-old");
    let long_ago = std::time::SystemTime::now() - 2 * MIN_AGE;
    let times = FileTimes::new().set_modified(long_ago);
    File::open(&old).unwrap().set_times(times).unwrap();
    // Not dead, or none of ours.
    let alive = make("sm2-demo-alive").join(LOCK);
    fs::write(&alive, "").unwrap();
    let lock = Flock::lock(File::open(&alive).unwrap(), FlockArg::LockExclusive).unwrap();
    make("sm2-demo-young");
    fs::write(make("other").join(LOCK), "").unwrap();
    std::os::unix::fs::symlink(
        parent.path().join("other"),
        parent.path().join("sm2-demo-link"),
    )
    .unwrap();

    remove_leftovers(parent.path());
    for name in ["sm2-demo-alive", "sm2-demo-young", "other", "sm2-demo-link"] {
        assert!(is_there(parent.path(), name), "{name}");
    }
    for name in ["sm2-demo-dead", "sm2-demo-old"] {
        assert!(!is_there(parent.path(), name), "{name}");
    }
    drop(lock);
}
