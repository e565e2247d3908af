//! A model of the kernel for waiting threads: descriptors that are readable or not, and sleeping
//! until one is readable. System calls order memory, and so does the lock here.

use std::collections::VecDeque;
use std::io;
use std::marker::PhantomData;
use std::time::Duration;

use loom::sync::{Condvar, Mutex};

loom::lazy_static! {
    static ref KERNEL: Kernel = Kernel {
        files: Mutex::new(Vec::new()),
        changed: Condvar::new(),
    };
}

struct Kernel {
    files: Mutex<Vec<File>>,
    changed: Condvar,
}

/// The file of a descriptor, which is an index.
enum File {
    Event(bool),
    Queue(VecDeque<u64>),
    /// Level-triggered.
    Set(Vec<usize>),
}

impl Kernel {
    fn open(&self, file: File) -> usize {
        let mut files = self.files.lock().unwrap();
        files.push(file);
        files.len() - 1
    }

    fn change<R>(&self, change: impl FnOnce(&mut Vec<File>) -> R) -> R {
        let result = change(&mut self.files.lock().unwrap());
        self.changed.notify_all();
        result
    }
}

fn readable(files: &[File], fd: usize) -> bool {
    match &files[fd] {
        File::Event(woken) => *woken,
        File::Queue(queue) => !queue.is_empty(),
        File::Set(all) => all.iter().any(|&fd| readable(files, fd)),
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct BorrowedFd<'a>(usize, PhantomData<&'a ()>);

pub(crate) trait AsFd {
    fn as_fd(&self) -> BorrowedFd<'_>;
}

impl AsFd for BorrowedFd<'_> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        *self
    }
}

/// Defines the type of a descriptor and its operations.
macro_rules! files {
    ($($name:ident)*) => {
        $(
            #[derive(Debug)]
            pub(crate) struct $name(usize);

            impl AsFd for $name {
                fn as_fd(&self) -> BorrowedFd<'_> {
                    BorrowedFd(self.0, PhantomData)
                }
            }
        )*
    };
}

files!(Waker Epoll Socket);

impl Waker {
    pub(crate) fn new() -> io::Result<Self> {
        Ok(Self(KERNEL.open(File::Event(false))))
    }

    pub(crate) fn wake(&self) {
        KERNEL.change(|files| files[self.0] = File::Event(true));
    }

    pub(crate) fn drain(&self) {
        KERNEL.change(|files| files[self.0] = File::Event(false));
    }
}

/// No process forks here.
#[derive(Debug)]
pub(crate) struct Maker;

impl Maker {
    pub(crate) const fn this_process() -> Self {
        Self
    }

    pub(crate) const fn is_parent(&self) -> bool {
        false
    }
}

pub(crate) struct Interest;

impl Interest {
    pub(crate) const READABLE: Self = Self;
}

impl Epoll {
    pub(crate) fn new() -> io::Result<Self> {
        Ok(Self(KERNEL.open(File::Set(Vec::new()))))
    }

    pub(crate) fn add(&self, file: &impl AsFd, _token: u64, _: Interest) -> io::Result<()> {
        let fd = file.as_fd().0;
        KERNEL.change(|files| match &mut files[self.0] {
            File::Set(all) => all.push(fd),
            _ => unreachable!("an epoll set"),
        });
        Ok(())
    }
}

/// The socket of a link. A message is a number.
impl Socket {
    pub(crate) fn new() -> Self {
        Self(KERNEL.open(File::Queue(VecDeque::new())))
    }

    pub(crate) fn send(&self, number: u64) {
        self.queue(|queue| queue.push_back(number));
    }

    pub(crate) fn receive(&self) -> Option<u64> {
        self.queue(VecDeque::pop_front)
    }

    fn queue<R>(&self, change: impl FnOnce(&mut VecDeque<u64>) -> R) -> R {
        KERNEL.change(|files| match &mut files[self.0] {
            File::Queue(queue) => change(queue),
            _ => unreachable!("a socket"),
        })
    }
}

/// Sleeps until one is readable. No time passes in these models.
pub(crate) fn wait_readable(fds: &[BorrowedFd<'_>], timeout: Option<Duration>) -> io::Result<bool> {
    assert!(timeout.is_none(), "nobody waits for a moment");
    let mut files = KERNEL.files.lock().unwrap();
    while !fds.iter().any(|fd| readable(&files, fd.0)) {
        files = KERNEL.changed.wait(files).unwrap();
    }
    Ok(true)
}

/// No call fails in these models.
pub(crate) const fn is_shortage(_: &io::Error) -> bool {
    false
}

pub(crate) mod clock {
    pub(crate) const fn now() -> sm2_proto::Instant {
        sm2_proto::Instant(0)
    }
}
