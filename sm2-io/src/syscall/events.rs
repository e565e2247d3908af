//! System calls that wait, and those that make and set what they wait for.

use std::os::fd::{AsFd, AsRawFd};
use std::time::Duration;

use nix::errno::Errno;
use nix::libc;
use nix::poll::ppoll;
pub(crate) use nix::poll::{PollFd, PollFlags};
use nix::sys::epoll::EpollCreateFlags;
pub(crate) use nix::sys::epoll::{Epoll, EpollEvent, EpollFlags, EpollTimeout};
use nix::sys::eventfd::EfdFlags;
pub(crate) use nix::sys::eventfd::EventFd;
use nix::sys::time::TimeSpec;
pub(crate) use nix::sys::timerfd::TimerFd;
use nix::sys::timerfd::{self, Expiration, TimerFlags, TimerSetTimeFlags};

use super::{Call, guard};

/// `CLOCK_MONOTONIC`: seconds and nanoseconds.
#[inline]
pub(crate) fn monotonic() -> nix::Result<libc::timespec> {
    read_clock(libc::CLOCK_MONOTONIC)
}

/// `CLOCK_MONOTONIC_COARSE`: that clock at the last tick.
#[inline]
pub(crate) fn last_tick() -> nix::Result<libc::timespec> {
    read_clock(libc::CLOCK_MONOTONIC_COARSE)
}

/// `clock_gettime(2)`. Each message reads the clock, and `nix` needs twice the instructions of the call itself.
#[inline]
fn read_clock(clock: libc::clockid_t) -> nix::Result<libc::timespec> {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: `time` is writable memory of the type that the call fills.
    match unsafe { libc::clock_gettime(clock, &raw mut time) } {
        0 => Ok(time),
        _ => Err(nix::errno::Errno::last()),
    }
}

pub(crate) fn epoll_create() -> nix::Result<Epoll> {
    guard(Call::EpollCreate)?;
    Epoll::new(EpollCreateFlags::EPOLL_CLOEXEC)
}

pub(crate) fn epoll_add(epoll: &Epoll, fd: impl AsFd, event: EpollEvent) -> nix::Result<()> {
    guard(Call::EpollCtl)?;
    epoll.add(fd, event)
}

pub(crate) fn epoll_modify(
    epoll: &Epoll,
    fd: impl AsFd,
    event: &mut EpollEvent,
) -> nix::Result<()> {
    guard(Call::EpollCtl)?;
    epoll.modify(fd, event)
}

/// Gives something back, so no test makes it fail.
pub(crate) fn epoll_remove(epoll: &Epoll, fd: impl AsFd) -> nix::Result<()> {
    epoll.delete(fd)
}

pub(crate) fn epoll_wait(
    epoll: &Epoll,
    events: &mut [EpollEvent],
    timeout: EpollTimeout,
) -> nix::Result<usize> {
    guard(Call::EpollWait)?;
    epoll.wait(events, timeout)
}

/// `struct __kernel_timespec`: 64 bits each, also where libc's is narrower.
#[repr(C)]
struct KernelTimespec {
    seconds: i64,
    nanoseconds: i64,
}

impl From<Duration> for KernelTimespec {
    fn from(duration: Duration) -> Self {
        Self {
            seconds: i64::try_from(duration.as_secs()).unwrap_or(i64::MAX),
            nanoseconds: i64::from(duration.subsec_nanos()),
        }
    }
}

/// `epoll_pwait2(2)`, whose timeout counts nanoseconds.
pub(crate) fn epoll_pwait2(
    epoll: &Epoll,
    events: &mut [EpollEvent],
    timeout: Option<Duration>,
) -> nix::Result<usize> {
    guard(Call::EpollWait)?;
    let timeout = timeout.map(KernelTimespec::from);
    let timeout = timeout
        .as_ref()
        .map_or(std::ptr::null(), std::ptr::from_ref);
    let room = libc::c_int::try_from(events.len()).unwrap_or(libc::c_int::MAX);
    // SAFETY: the buffer has `room` elements with the layout of `epoll_event` (`EpollEvent` is
    // transparent), and this function borrows it exclusively; `timeout` is null or points to a
    // live `KernelTimespec`, which has the kernel's layout; the kernel ignores a null mask.
    let count = unsafe {
        libc::syscall(
            libc::SYS_epoll_pwait2,
            epoll.0.as_raw_fd(),
            events.as_mut_ptr(),
            room,
            timeout,
            std::ptr::null::<libc::sigset_t>(),
            0_usize,
        )
    };
    Errno::result(count).map(|count| usize::try_from(count).unwrap_or(0))
}

pub(crate) fn poll(fds: &mut [PollFd<'_>], timeout: Option<Duration>) -> nix::Result<usize> {
    guard(Call::Poll)?;
    let count = ppoll(fds, timeout.map(TimeSpec::from_duration), None)?;
    Ok(usize::try_from(count).unwrap_or(0))
}

/// An eventfd, close-on-exec, non-blocking.
pub(crate) fn eventfd() -> nix::Result<EventFd> {
    guard(Call::EventFd)?;
    EventFd::from_value_and_flags(0, EfdFlags::EFD_CLOEXEC | EfdFlags::EFD_NONBLOCK)
}

/// A timer on the monotonic clock, close-on-exec, non-blocking.
pub(crate) fn timer() -> nix::Result<TimerFd> {
    guard(Call::TimerCreate)?;
    let flags = TimerFlags::TFD_NONBLOCK | TimerFlags::TFD_CLOEXEC;
    TimerFd::new(timerfd::ClockId::CLOCK_MONOTONIC, flags)
}

/// Sets the timer to a time of the clock; `None` clears it.
pub(crate) fn timer_set(timer: &TimerFd, at: Option<Duration>) -> nix::Result<()> {
    guard(Call::TimerSet)?;
    let Some(at) = at else { return timer.unset() };
    let at = Expiration::OneShot(TimeSpec::from_duration(at));
    timer.set(at, TimerSetTimeFlags::TFD_TIMER_ABSTIME)
}
