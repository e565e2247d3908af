//! Gateways in separate processes.

use std::{
    fs,
    path::Path,
    process::{Child, Command, Stdio},
};

/// A gateway in a separate process, which is killed when the test ends.
pub(crate) struct Process(Child);

impl Process {
    pub(crate) fn start(config: &Path) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_sm2-gateway"));
        let command = command.arg("run").arg(config);
        let command = command.stdout(Stdio::null()).stderr(Stdio::null());
        Self(command.spawn().unwrap())
    }

    /// Kills the process with SIGKILL.
    pub(crate) fn kill(mut self) {
        self.0.kill().unwrap();
        assert!(!self.0.wait().unwrap().success());
    }

    /// The value of a line of `/proc/PID/status`.
    pub(crate) fn status(&self, line: &str) -> String {
        let status = fs::read_to_string(format!("/proc/{}/status", self.0.id())).unwrap();
        let value = status.lines().find_map(|it| it.strip_prefix(line));
        value.unwrap().trim().to_owned()
    }

    /// Reads a memory line of `/proc/PID/status`, in bytes.
    pub(crate) fn memory(&self, line: &str) -> usize {
        let kib = self.status(&format!("{line}:"));
        let kib = kib.split_whitespace().next().unwrap();
        kib.parse::<usize>().unwrap() << 10
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
