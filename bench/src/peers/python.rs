//! Peers in Python. Their processes are the program `bench/python/role.py`, which takes the same jobs.
//!
//! The payload is written and checked by the library of `bench/python/payload.rs`: an example of this package, which
//! `cargo build --release --examples` puts beside this program.

use std::{env, path::PathBuf, process::Command};

/// The program.
const ROLE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/python/role.py");

/// The variable that names the Python interpreter, which has the packages.
const INTERPRETER: &str = "SM2_BENCH_PYTHON";

/// The command that runs a process in Python. Its argument is the job.
///
/// # Errors
///
/// The library of the payload is missing.
pub fn command() -> Result<Command, String> {
    let mut command = interpreter();
    command.arg(ROLE).env("SM2_BENCH_PAYLOAD", payload()?);
    Ok(command)
}

fn interpreter() -> Command {
    Command::new(env::var_os(INTERPRETER).unwrap_or_else(|| "python3".into()))
}

fn payload() -> Result<PathBuf, String> {
    let program = env::current_exe().map_err(|error| error.to_string())?;
    let path = program.with_file_name("examples").join("libpayload.so");
    match path.exists() {
        true => Ok(path),
        false => Err(format!(
            "{} is missing: build it with `cargo build --release --examples`",
            path.display()
        )),
    }
}

/// Checks that Python has the packages of a peer.
///
/// # Errors
///
/// The missing part, and how to install it.
pub fn available(peer: &str) -> Result<(), String> {
    let (module, package) = match peer {
        "sm2-python" => ("sm2", "./sm2-python"),
        "iceoryx2-python" => ("iceoryx2", "iceoryx2"),
        "zenoh-python" => ("zenoh", "eclipse-zenoh"),
        _ => ("cyclonedds", "cyclonedds"),
    };
    payload()?;
    let output = interpreter()
        .args(["-c", &format!("import {module}")])
        .output()
        .map_err(|error| format!("no Python: {error}; set {INTERPRETER} to an interpreter"))?;
    if output.status.success() {
        return Ok(());
    }
    let text = String::from_utf8_lossy(&output.stderr);
    let reason = text.lines().last().unwrap_or("it cannot be imported");
    Err(format!(
        "{reason}; needs `pip install {package}` for the interpreter of {INTERPRETER}"
    ))
}

#[cfg(test)]
mod tests {
    use super::{ROLE, available, command};

    #[test]
    fn a_process_needs_the_library_of_the_payload() {
        // The program of the tests is in another folder than the examples.
        let missing = "libpayload.so is missing";
        for reason in [available("sm2-python"), command().map(drop)] {
            assert!(reason.unwrap_err().contains(missing));
        }
        assert!(std::path::Path::new(ROLE).exists());
    }
}
