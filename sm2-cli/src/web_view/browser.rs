//! Opens the page in the person's browser.
//!
//! Every user of the machine can read the arguments of a program, so the browser does not get the URL as an argument,
//! but a file that only this user can read, and that leads to the URL.

use std::{
    env,
    fs::{self, OpenOptions},
    io::{self, Write},
    os::unix::fs::OpenOptionsExt,
    path::PathBuf,
    process::{self, Command, Stdio},
};

/// The program that knows the person's browser.
const OPENER: &str = "xdg-open";

/// A file that leads to the page. It is removed when the value is dropped.
#[derive(Debug)]
pub(super) struct Shortcut(PathBuf);

impl Shortcut {
    /// Writes the file, and has the browser open it.
    ///
    /// # Errors
    ///
    /// The file cannot be made, or there is no `xdg-open`.
    pub(super) fn open(url: &str) -> io::Result<Self> {
        let folder = env::var_os("XDG_RUNTIME_DIR").map_or_else(env::temp_dir, PathBuf::from);
        let path = folder.join(format!("sm2-view-{}.html", process::id()));
        let mut options = OpenOptions::new();
        // `create_new` follows no link that another user has put there.
        let mut file = options
            .write(true)
            .create_new(true)
            .mode(0o600)
            .open(&path)?;
        let shortcut = Self(path);
        // The token has hex digits, and an address no characters of markup.
        writeln!(
            file,
            "<!doctype html><meta http-equiv=\"refresh\" content=\"0; url={url}\">"
        )?;
        let mut command = Command::new(OPENER);
        command.arg(&shortcut.0).stdin(Stdio::null());
        // The output of a browser would be between that of this command.
        command
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        Ok(shortcut)
    }
}

impl Drop for Shortcut {
    fn drop(&mut self) {
        // It leads to a server that has ended.
        let _ = fs::remove_file(&self.0);
    }
}
