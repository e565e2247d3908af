//! `sm2 foxglove` becomes another program.

use std::os::unix::fs::symlink;

use crate::common::{Running, sm2};

#[test]
fn the_arguments_go_to_the_program() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = sm2(&["foxglove", "--listen", "127.0.0.1:0", "scan"]);
    command.env("PATH", folder.path());
    let absent = Running::start(&mut command).finish();
    absent.failed(
        1,
        &[
            "cannot start sm2-foxglove",
            "cargo install --path sm2-foxglove",
        ],
    );
    symlink("/bin/echo", folder.path().join("sm2-foxglove")).unwrap();
    let found = Running::start(&mut command).finish();
    assert_eq!(found.stdout(), "--listen 127.0.0.1:0 scan\n");
    assert_eq!(found.code(), 0);
}
