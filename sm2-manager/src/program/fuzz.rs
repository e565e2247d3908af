//! Checks for a fuzz target of the command line. Nothing is started.
use sm2_io::{DomainSocketError, domain_socket::MAX_PATH_BYTES};

use super::Arguments;
use crate::StartError;

/// Checks that valid arguments give usable options: limits within their ranges, and a mode that
/// contains only permission bits. Panics otherwise.
pub fn check(arguments: &Arguments) {
    let Ok(options) = arguments.options() else {
        return;
    };
    let limits = options.limits;
    assert!(options.socket_mode <= 0o777);
    assert_eq!(limits.check(), Ok(()));
    assert!(!(limits.seal_all && limits.waive_user_boundary));
    assert!(!(arguments.standby && arguments.replace));
    match arguments.explicit_path() {
        Ok(path) => {
            let asked = arguments.socket.is_some() || arguments.domain.is_some();
            assert_eq!(path.is_some(), asked);
            if let (Some(path), None) = (&path, &arguments.socket) {
                assert!(path.is_absolute() && path.as_os_str().len() <= MAX_PATH_BYTES);
            }
        }
        // A path that is too long is refused when the socket is bound.
        Err(StartError::DomainSocket(
            DomainSocketError::DomainName { .. } | DomainSocketError::PathTooLong { .. },
        )) => {}
        Err(other) => panic!("{other}"),
    }
}
