//! A receiver that never reads. Alone in its process: the test lowers a limit and gives up privileges.

use sm2_test_support::ran_alone;
use std::io::IoSlice;
use std::os::fd::AsFd;

use nix::libc;
use nix::sys::resource::{Resource, getrlimit, setrlimit};
use sm2_io::{SendError, SeqPacket};

#[test]
fn too_many_descriptors_in_flight_is_an_answer_of_its_own() {
    if ran_alone(concat!(
        module_path!(),
        "::too_many_descriptors_in_flight_is_an_answer_of_its_own"
    )) {
        return;
    }
    let file = tempfile::tempfile().unwrap();
    let pairs: Vec<_> = (0..8).map(|_| SeqPacket::pair().unwrap()).collect();
    let (_, hard) = getrlimit(Resource::RLIMIT_NOFILE).unwrap();
    setrlimit(Resource::RLIMIT_NOFILE, 64, hard).unwrap();
    // The limit does not apply to root.
    let nobody: libc::uid_t = 65534;
    // SAFETY: takes three numbers; the bare system call changes this thread only.
    unsafe { libc::syscall(libc::SYS_setresuid, nobody, nobody, nobody) };

    let byte = [IoSlice::new(b"x")];
    let mut results = pairs
        .iter()
        .map(|(a, _)| a.send(&byte, &[file.as_fd(); 50]));
    assert!(results.next().unwrap().is_ok());
    assert!(results.any(|result| matches!(result, Err(SendError::TooManyInFlight))));
}
