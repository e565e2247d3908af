//! The error convention: a code for each call, and a text of the thread's last error.

use std::any::Any;
use std::borrow::Cow;
use std::cell::RefCell;
use std::error::Error;
use std::ffi::{CStr, c_char, c_int};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// The result of a call: `SM2_OK`, or the kind of error. `sm2_last_error()` returns the error's text.
///
/// The numbers never change. Later versions of the library may add codes, so a program treats a code that it does not
/// know as it treats `SM2_UNKNOWN`.
#[repr(i32)]
#[allow(
    non_camel_case_types,
    clippy::upper_case_acronyms,
    reason = "cbindgen can add a prefix to a name, or change its case, but not both"
)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// The call did what it was asked for.
    OK = 0,
    /// The time limit has passed without a result: no message, no reply, too few links. For a call with the limit 0:
    /// nothing is there now.
    TIMED_OUT = 1,
    /// The program requested a shutdown while the call waited: see `sm2_shutdown_request()`.
    SHUTDOWN = 2,
    /// An argument is NULL, not UTF-8, out of its range, or a handle that is spent.
    MISUSE = 3,
    /// The operating system refused: `sm2_last_errno()` returns its error number.
    IO = 4,
    /// A bug of this library: a panic was caught. Free the handles of the call and do not use them further.
    PANIC = 5,
    /// An error that has no code in this version of the library.
    UNKNOWN = 6,

    /// The name of a node, topic, service, type or domain is not legal.
    BAD_NAME = 10,
    /// A value of the quality of service is out of its range, or contradicts another one.
    BAD_QOS = 11,
    /// A schema text is malformed.
    BAD_SCHEMA = 12,
    /// The topic or service carries other types. The text shows both.
    TYPE_MISMATCH = 13,
    /// The domain has no Manager, or the Manager did not answer in time.
    NO_MANAGER = 14,
    /// Another node of the domain has this name.
    NAME_TAKEN = 15,
    /// The Manager refused the request: its access policy, its version or another rule.
    REFUSED = 16,
    /// A quota of the Manager is used up.
    QUOTA = 17,

    /// The message is longer than the protocol or its receiver allows.
    TOO_LONG = 20,
    /// All memory of the publisher holds messages that subscribers have not released.
    POOL_FULL = 21,
    /// Reliable subscribers missed the message.
    MISSED = 22,
    /// The program holds as many messages, replies or calls as `max_borrowed` allows.
    BORROW_LIMIT = 23,
    /// A message of another node could not be mapped, or is not of its declared type.
    UNREADABLE = 24,

    /// No server of the service is linked.
    NO_SERVER = 30,
    /// The server ended before it replied.
    SERVER_GONE = 31,
    /// The deadline of the call has passed.
    DEADLINE_EXCEEDED = 32,
    /// The program cancelled the call.
    CANCELLED = 33,
    /// The server answered that the request failed. The text has its reason.
    CALL_FAILED = 34,
    /// The client of the request is gone.
    CLIENT_GONE = 35,
}

/// The name of each code in C.
const NAMES: [(Status, &CStr); 26] = [
    (Status::OK, c"SM2_OK"),
    (Status::TIMED_OUT, c"SM2_TIMED_OUT"),
    (Status::SHUTDOWN, c"SM2_SHUTDOWN"),
    (Status::MISUSE, c"SM2_MISUSE"),
    (Status::IO, c"SM2_IO"),
    (Status::PANIC, c"SM2_PANIC"),
    (Status::UNKNOWN, c"SM2_UNKNOWN"),
    (Status::BAD_NAME, c"SM2_BAD_NAME"),
    (Status::BAD_QOS, c"SM2_BAD_QOS"),
    (Status::BAD_SCHEMA, c"SM2_BAD_SCHEMA"),
    (Status::TYPE_MISMATCH, c"SM2_TYPE_MISMATCH"),
    (Status::NO_MANAGER, c"SM2_NO_MANAGER"),
    (Status::NAME_TAKEN, c"SM2_NAME_TAKEN"),
    (Status::REFUSED, c"SM2_REFUSED"),
    (Status::QUOTA, c"SM2_QUOTA"),
    (Status::TOO_LONG, c"SM2_TOO_LONG"),
    (Status::POOL_FULL, c"SM2_POOL_FULL"),
    (Status::MISSED, c"SM2_MISSED"),
    (Status::BORROW_LIMIT, c"SM2_BORROW_LIMIT"),
    (Status::UNREADABLE, c"SM2_UNREADABLE"),
    (Status::NO_SERVER, c"SM2_NO_SERVER"),
    (Status::SERVER_GONE, c"SM2_SERVER_GONE"),
    (Status::DEADLINE_EXCEEDED, c"SM2_DEADLINE_EXCEEDED"),
    (Status::CANCELLED, c"SM2_CANCELLED"),
    (Status::CALL_FAILED, c"SM2_CALL_FAILED"),
    (Status::CLIENT_GONE, c"SM2_CLIENT_GONE"),
];

/// Why a call did not do what it was asked for.
#[derive(Debug)]
pub(crate) struct Failure {
    pub(crate) status: Status,
    pub(crate) text: Cow<'static, str>,
    /// The error number of the operating system; 0 if it did not refuse anything.
    errno: c_int,
}

impl Failure {
    /// The call found nothing within its time limit.
    pub(crate) const TIMED_OUT: Self = Self {
        status: Status::TIMED_OUT,
        text: Cow::Borrowed("the time limit has passed without a result"),
        errno: 0,
    };

    /// The program passed an argument that it must not pass.
    pub(crate) fn misuse(text: impl Into<Cow<'static, str>>) -> Self {
        Self {
            status: Status::MISUSE,
            text: text.into(),
            errno: 0,
        }
    }

    /// An error of a library of SM2, with its own text, and the error of the operating system that caused it.
    pub(crate) fn new(status: Status, error: &dyn Error, cause: Option<&io::Error>) -> Self {
        Self {
            status,
            text: error.to_string().into(),
            errno: cause.and_then(io::Error::raw_os_error).unwrap_or(0),
        }
    }

    fn panicked(payload: &(dyn Any + Send)) -> Self {
        let texts = (payload.downcast_ref::<&str>().copied())
            .or_else(|| payload.downcast_ref::<String>().map(String::as_str));
        let text = texts.unwrap_or("no text");
        Self {
            status: Status::PANIC,
            text: format!("a bug of SM2, please report it: {text}").into(),
            errno: 0,
        }
    }
}

/// Runs the body of an entry point: no panic leaves it, and an error becomes the last one of this thread.
pub(crate) fn guard(body: impl FnOnce() -> Result<(), Failure>) -> Status {
    // A handle stays usable as far as Rust is concerned: no type of sm2-node relies on the absence of panics for its
    // memory safety, and all of its locks go on after a panic.
    let failure = match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => return Status::OK,
        Ok(Err(failure)) => failure,
        Err(payload) => Failure::panicked(payload.as_ref()),
    };
    // A thread that is ending may have lost its place for the text already.
    let _ = LAST.try_with(|last| last.borrow_mut().set(&failure));
    failure.status
}

/// Runs the body of an entry point that has nothing to report.
pub(crate) fn guard_drop<T>(value: T) {
    guard(|| {
        drop(value);
        Ok(())
    });
}

/// The last error of a thread.
struct Last {
    /// Ends with NUL. Keeps its memory, so that a call that often finds nothing does not allocate.
    text: Vec<u8>,
    errno: c_int,
}

impl Last {
    const NONE: Self = Self {
        text: Vec::new(),
        errno: 0,
    };

    fn set(&mut self, failure: &Failure) {
        self.text.clear();
        let bytes = failure.text.bytes();
        // A text of another node may have any character.
        (self.text).extend(bytes.map(|it| if it == 0 { b'?' } else { it }));
        self.text.push(0);
        self.errno = failure.errno;
    }
}

thread_local! {
    static LAST: RefCell<Last> = const { RefCell::new(Last::NONE) };
}

/// Returns the text of the last error of this thread, in UTF-8: what happened, where, and what to do. It is the text
/// that the Rust library gives for the same error; for `SM2_TYPE_MISMATCH`, lines with both schemas follow it.
///
/// Calls that succeed do not change the text. It is empty before the first error. The pointer is valid until the next
/// call of this thread that fails.
///
/// Threads: any; each thread has a text of its own.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_last_error() -> *const c_char {
    let text = LAST.try_with(|last| match last.borrow().text.as_slice() {
        [] => c"".as_ptr(),
        text => text.as_ptr().cast(),
    });
    text.unwrap_or(c"".as_ptr())
}

/// Returns the error number (`errno`) of the operating system that caused the last error of this thread; 0 if the
/// operating system did not cause it.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_last_errno() -> c_int {
    LAST.try_with(|last| last.borrow().errno).unwrap_or(0)
}

/// Returns the name of a code, such as `SM2_TIMED_OUT`; that of `SM2_UNKNOWN` for a number that is not a code. The text
/// is valid forever.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_status_name(status: i32) -> *const c_char {
    let mut names = NAMES.iter();
    let name = names.find(|(it, _)| *it as i32 == status);
    name.map_or(c"SM2_UNKNOWN", |(_, name)| name).as_ptr()
}
