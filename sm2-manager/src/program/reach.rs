//! A socket that admits users whom its directory keeps out.

use std::{fs, os::unix::fs::PermissionsExt, path::Path};

/// The bits of a mode that belong to the users other than the owner: `w` of a socket lets them connect,
/// `x` of a directory lets them reach the files in it.
const CLASSES: [(&str, &str, u32, u32); 2] = [
    ("its group", "g+x", 0o020, 0o010),
    ("all users", "o+x", 0o002, 0o001),
];

/// Warns if the mode of the socket admits users whom its directory keeps out.
pub(super) fn warn_of_closed_directory(socket: &Path, socket_mode: u32) {
    let Some(directory) = socket.parent() else {
        return;
    };
    let Ok(found) = fs::metadata(directory) else {
        return;
    };
    let mode = found.permissions().mode() & 0o777;
    for (users, change) in kept_out(socket_mode, mode) {
        let directory = directory.display();
        tracing::warn!(
            "--socket-mode {socket_mode:03o} lets {users} connect, but the directory {directory} (mode {mode:03o}) \
             keeps them out: run 'chmod {change} {directory}' and give the directory the right group, or choose \
             a socket in another directory with --socket"
        );
    }
}

/// The users whom the socket admits and its directory keeps out, with the change of the directory's mode.
fn kept_out(
    socket_mode: u32,
    directory_mode: u32,
) -> impl Iterator<Item = (&'static str, &'static str)> {
    let of = CLASSES.into_iter().filter(move |(_, _, connect, reach)| {
        socket_mode & connect != 0 && directory_mode & reach == 0
    });
    of.map(|(users, change, _, _)| (users, change))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn users_are_kept_out_if_they_may_connect_and_not_reach() {
        let kept = |socket, directory| -> Vec<&str> {
            kept_out(socket, directory).map(|it| it.1).collect()
        };
        let none: Vec<&str> = Vec::new();
        assert_eq!(kept(0o600, 0o700), none);
        assert_eq!(
            kept(0o640, 0o700),
            none,
            "reading a socket is not connecting"
        );
        assert_eq!(kept(0o660, 0o700), ["g+x"]);
        assert_eq!(kept(0o660, 0o710), none);
        assert_eq!(kept(0o666, 0o700), ["g+x", "o+x"]);
        assert_eq!(kept(0o666, 0o710), ["o+x"]);
        assert_eq!(kept(0o666, 0o755), none);
    }
}
