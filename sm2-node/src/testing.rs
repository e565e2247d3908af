//! Domains for tests: see [`TestDomain`].

use std::fs::{self, DirBuilder, OpenOptions};
use std::io;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::process::{self, Command};
use std::sync::{Mutex, PoisonError};

use sm2_manager::{Background, Options, StartError};

use crate::{ConnectError, Node, NodeBuilder};

/// `O_PATH` of `open(2)`, the same on all processors that Rust supports on Linux but sparc.
const O_PATH: i32 = 0o10_000_000;

/// A domain for one test, with a Manager in this process. It has no name and no port, and leaves no file behind, even
/// if the test is killed: other tests and the robot's own domain do not see it, so tests can run at the same time.
///
/// ```
/// use sm2_node::testing::TestDomain;
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let domain = TestDomain::new()?;
/// let (talker, listener) = (domain.node("talker")?, domain.node("listener")?);
/// let (topic, heard) = (talker.publisher::<str>("chatter")?, listener.subscriber::<str>("chatter")?);
/// topic.wait_for_subscribers(1)?;
/// topic.publish("hello")?;
/// assert_eq!(&*heard.recv()?, "hello");
/// # Ok(())
/// # }
/// ```
///
/// The Manager ends when the value is dropped. The nodes then have no Manager, but their links stay open.
#[derive(Debug)]
pub struct TestDomain {
    /// The socket, which has no name any more. Before the folder is removed, nodes could use it by its name.
    _socket: OwnedFd,
    path: PathBuf,
    _manager: Background,
}

/// A test domain cannot be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TestDomainError {
    /// The folder of the socket cannot be used.
    #[error("cannot make the socket of a test domain in {path:?}: {source}; is TMPDIR a folder?")]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The error of the operating system.
        r#source: io::Error,
    },
    /// The Manager cannot be started.
    #[error(transparent)]
    Manager(#[from] StartError),
}

impl TestDomain {
    /// Starts a Manager with the default options.
    ///
    /// # Errors
    ///
    /// See [`TestDomainError`].
    pub fn new() -> Result<Self, TestDomainError> {
        Self::with_options(Options::default())
    }

    /// Starts a Manager with limits or an access policy. The policy cannot be read again later.
    ///
    /// # Errors
    ///
    /// See [`TestDomainError`].
    pub fn with_options(options: Options) -> Result<Self, TestDomainError> {
        let folder = Folder::new()?;
        let name = folder.0.join("socket");
        let manager = Background::start(&name, options)?;
        let mut open = OpenOptions::new();
        let socket = open.read(true).custom_flags(O_PATH).open(&name);
        let socket = OwnedFd::from(socket.map_err(|source| folder.error(source))?);
        // The kernel finds a socket by its inode, so it needs no name.
        let path = format!("/proc/{}/fd/{}", process::id(), socket.as_raw_fd());
        Ok(Self {
            _socket: socket,
            path: path.into(),
            _manager: manager,
        })
    }

    /// Connects a node.
    ///
    /// # Errors
    ///
    /// See [`ConnectError`].
    pub fn node(&self, name: &str) -> Result<Node, ConnectError> {
        self.builder(name).connect()
    }

    /// Returns the builder of a node.
    pub fn builder(&self, name: &str) -> NodeBuilder {
        Node::builder(name).socket(&self.path)
    }

    /// The path of the Manager's socket, for this process and its children of the same user.
    #[must_use]
    pub fn socket(&self) -> &Path {
        &self.path
    }

    /// Returns a command that runs a program in this domain: `Node::new` of the program connects to it (`SM2_SOCKET`).
    pub fn command(&self, program: impl AsRef<Path>) -> Command {
        let mut command = Command::new(program.as_ref());
        command.env_remove("SM2_DOMAIN");
        command.env("SM2_SOCKET", &self.path);
        command
    }
}

/// A new folder that only this user can read. Removed when dropped.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Result<Self, TestDomainError> {
        static LAST: Mutex<u64> = Mutex::new(0);
        loop {
            let number = {
                let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
                *last += 1;
                *last
            };
            let name = format!("sm2-test-{}-{number}", process::id());
            let path = std::env::temp_dir().join(name);
            match DirBuilder::new().mode(0o700).create(&path) {
                Ok(()) => return Ok(Self(path)),
                // Left by a process with the same number, which was killed before the folder was removed.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(source) => return Err(TestDomainError::Folder { path, source }),
            }
        }
    }

    fn error(&self, source: io::Error) -> TestDomainError {
        TestDomainError::Folder {
            path: self.0.clone(),
            source,
        }
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}
