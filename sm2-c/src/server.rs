//! Servers and their requests.

use std::ffi::{c_char, c_int, c_void};
use std::mem::MaybeUninit;

use sm2_node::ServerBuilder;

use crate::aligned::AlignedCopy;
use crate::arguments::{
    Bytes, FOREVER, In, Out, Text, duration, given, sized, store_bytes, store_descriptor, vacant,
};
use crate::node::Node;
use crate::qos::ServerOptions;
use crate::report::why;
use crate::status::{Failure, Status, guard, guard_drop};
use crate::types::{Type, not_declared, service_types};

/// Answers the calls of a service: see `sm2_server_new()`.
#[derive(Debug)]
pub struct Server(pub(crate) sm2_node::Server<[u8], [u8]>);

/// A request, whose client waits for an answer: see `sm2_server_recv()`.
#[derive(Debug, Default)]
pub struct Request {
    /// `None` once the request is answered.
    request: Option<sm2_node::Request<[u8], [u8]>>,
    copy: AlignedCopy,
}

// A program may answer a request on another thread than the one that took it, as the header says.
const _: fn() = || {
    fn can_be_shared<T: Send + Sync>() {}
    can_be_shared::<Request>();
};

/// Deadline and client of a request.
#[repr(C)]
#[derive(Debug)]
pub struct RequestInfo {
    /// The size of this struct, in bytes.
    pub size: usize,
    /// The time after which the client does not want the reply any more, in nanoseconds of `CLOCK_MONOTONIC`; 0 for
    /// none.
    pub deadline_ns: u64,
    /// The name of the client's node. Has no NUL at its end, and is valid until the request is answered.
    pub client: *const c_char,
    /// The length of `client`.
    pub client_len: usize,
}

sized! { RequestInfo, client_len: usize = "sm2_request_info_t"; }

impl Request {
    fn held(&self) -> Result<&sm2_node::Request<[u8], [u8]>, Failure> {
        self.request.as_ref().ok_or_else(Self::spent)
    }

    fn take(&mut self) -> Result<sm2_node::Request<[u8], [u8]>, Failure> {
        self.request.take().ok_or_else(Self::spent)
    }

    fn spent() -> Failure {
        Failure::misuse("the request is empty: it was answered; receive another one")
    }
}

/// Declares a server. `request` and `reply` are the types of requests and replies, both NULL for raw bytes. `options`
/// is NULL for the defaults.
///
/// Errors: `SM2_TYPE_MISMATCH`, `SM2_BAD_NAME`, `SM2_BAD_SCHEMA`, `SM2_BAD_QOS`, `SM2_NO_MANAGER`, `SM2_REFUSED`,
/// `SM2_QUOTA`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_server_new(
    node: Option<&Node>,
    service: *const c_char,
    request: *const Type,
    reply: *const Type,
    options: *const ServerOptions,
    server: Option<&mut MaybeUninit<Option<Box<Server>>>>,
) -> Status {
    guard(|| {
        let server = vacant(server, "server")?;
        let node = &given(node, "node")?.0;
        let service = Text(service);
        let options = In(options).read_or(ServerOptions::defaults)?;
        let mut builder: ServerBuilder<[u8], [u8]> =
            node.server_builder(service.required("service")?);
        if let Some((request, reply)) = service_types(node, request, reply)? {
            builder = builder.type_ids(request, reply);
        }
        let declared = options.apply(builder)?.declare();
        let declared = declared.map_err(|error| not_declared(node, error))?;
        *server = Some(Box::new(Server(declared)));
        Ok(())
    })
}

/// Frees a server, which is withdrawn once all requests that it took are answered; NULL is ignored.
///
/// Threads: any, but no other call may use this handle at the same time or later.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_server_free(server: Option<Box<Server>>) {
    guard_drop(server);
}

/// Takes the next request. Waits for it for at most `timeout_ns` nanoseconds: not at all with 0, and without limit with
/// `SM2_FOREVER`.
///
/// `*request` is NULL, or a request of an earlier call, whose handle is used again. If it was not answered, its client
/// learns that it failed.
///
/// Errors: `SM2_TIMED_OUT`, `SM2_BORROW_LIMIT` if the program holds `max_borrowed` requests, `SM2_UNREADABLE`,
/// `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time with other requests.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_server_recv(
    server: Option<&Server>,
    timeout_ns: u64,
    request: Option<&mut Option<Box<Request>>>,
) -> Status {
    guard(|| {
        let place = given(request, "request")?;
        let server = &given(server, "server")?.0;
        if let Some(earlier) = place {
            earlier.request = None;
        }
        let received = match timeout_ns {
            0 => server.try_recv()?,
            FOREVER => Some(server.recv()?),
            ns => server.recv_timeout(duration(ns))?,
        };
        let received = received.ok_or(Failure::TIMED_OUT)?;
        let request = place.get_or_insert_default();
        request.copy.align(&received);
        request.request = Some(received);
        Ok(())
    })
}

/// Waits until at least `count` clients are linked, for at most `timeout_ns` nanoseconds (`SM2_FOREVER`: no limit).
///
/// Errors: `SM2_TIMED_OUT`, `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_server_wait_for_clients(
    server: Option<&Server>,
    count: usize,
    timeout_ns: u64,
) -> Status {
    guard(|| {
        let server = &given(server, "server")?.0;
        match timeout_ns {
            FOREVER => server.wait_for_clients(count)?,
            ns => server.wait_for_clients_timeout(count, duration(ns))?,
        }
        Ok(())
    })
}

/// Stores a descriptor in `fd` that is readable when `sm2_server_recv()` with the limit 0 may have a request. The
/// server keeps the descriptor; do not close it.
///
/// Errors: `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_server_descriptor(
    server: Option<&Server>,
    fd: Option<&mut MaybeUninit<c_int>>,
) -> Status {
    guard(|| store_descriptor(&given(server, "server")?.0, fd))
}

/// Explains why the server has no links: stores a text in `text`, with a line for each client that comes close. The
/// text is empty if there is none. Free it with `sm2_text_free()`.
///
/// Errors: `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_server_why(
    server: Option<&Server>,
    text: Option<&mut MaybeUninit<*mut c_char>>,
) -> Status {
    guard(|| why(text, || Ok(given(server, "server")?.0.why()?)))
}

/// Stores the bytes of a request in `data`, and their number in `len`. They are aligned to 64 bytes, and do not change
/// until the request is answered, freed or used again.
///
/// Errors: `SM2_MISUSE`, also if the request is empty.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_request_data(
    request: Option<&Request>,
    data: Option<&mut MaybeUninit<*const c_void>>,
    len: Option<&mut MaybeUninit<usize>>,
) -> Status {
    guard(|| {
        let request = given(request, "request")?;
        let bytes = request.copy.of(request.held()?);
        store_bytes(bytes, data, "data", len)
    })
}

/// Fills `info`: deadline and client of a request.
///
/// Errors: `SM2_MISUSE`, also if the request is empty.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_request_info(request: Option<&Request>, info: *mut RequestInfo) -> Status {
    guard(|| {
        let info = Out(info).required("info")?;
        let request = given(request, "request")?.held()?;
        let client = request.client().as_str();
        info.write(&RequestInfo {
            size: size_of::<RequestInfo>(),
            deadline_ns: request.deadline().map_or(0, |it| it.0),
            client: client.as_ptr().cast(),
            client_len: client.len(),
        });
        Ok(())
    })
}

/// Stores in `cancelled` whether the reply is not wanted any more: the client cancelled the call or is gone, or the
/// deadline has passed. Long work asks this now and then.
///
/// Errors: `SM2_MISUSE`, also if the request is empty.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_request_is_cancelled(
    request: Option<&Request>,
    cancelled: Option<&mut MaybeUninit<bool>>,
) -> Status {
    guard(|| {
        let request = given(request, "request")?.held()?;
        given(cancelled, "cancelled")?.write(request.is_cancelled());
        Ok(())
    })
}

/// Answers a request with the `len` bytes at `data`, and does not wait. The reply may be in the memory of the request.
/// The request is empty then, also after an error other than `SM2_MISUSE`.
///
/// Errors: `SM2_CLIENT_GONE`, `SM2_TOO_LONG`, `SM2_POOL_FULL`, `SM2_IO`, `SM2_MISUSE`, also if the request is empty.
///
/// Threads: any, but no other call may use this request at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_request_reply(
    request: Option<&mut Request>,
    data: *const c_void,
    len: usize,
) -> Status {
    guard(|| {
        let request = given(request, "request")?;
        let bytes = Bytes(data);
        let bytes = bytes.slice(len, "data")?;
        Ok(request.take()?.reply(bytes)?)
    })
}

/// Answers that a request failed, with a reason for its client. The request is empty then, also after an error other
/// than `SM2_MISUSE`.
///
/// Errors: `SM2_CLIENT_GONE`, `SM2_IO`, `SM2_MISUSE`, also if the request is empty.
///
/// Threads: any, but no other call may use this request at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_request_fail(request: Option<&mut Request>, reason: *const c_char) -> Status {
    guard(|| {
        let request = given(request, "request")?;
        let reason = Text(reason);
        let reason = reason.required("reason")?;
        Ok(request.take()?.fail(reason)?)
    })
}

/// Frees a request; NULL is ignored. If it was not answered, its client learns that it failed.
///
/// Threads: any, but no other call may use this handle at the same time or later.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_request_free(request: Option<Box<Request>>) {
    guard_drop(request);
}
