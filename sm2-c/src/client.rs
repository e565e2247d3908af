//! Clients, their calls, and replies.

use std::ffi::{c_char, c_int, c_void};
use std::mem::MaybeUninit;

use sm2_node::ClientBuilder;

use crate::aligned::AlignedCopy;
use crate::arguments::{
    Bytes, FOREVER, In, Text, duration, given, store_bytes, store_descriptor, vacant,
};
use crate::node::Node;
use crate::qos::ClientOptions;
use crate::report::why;
use crate::status::{Failure, Status, guard, guard_drop};
use crate::types::{Type, not_declared, service_types};

/// Calls a service: see `sm2_client_new()`.
#[derive(Debug)]
pub struct Client(sm2_node::Client<[u8], [u8]>);

/// A pending call: see `sm2_client_send()`.
#[derive(Debug, Default)]
pub struct Call {
    /// `None` once its result was returned.
    call: Option<sm2_node::Call<[u8]>>,
}

/// A reply: see `sm2_client_call()`.
#[derive(Debug, Default)]
pub struct Reply {
    /// `None` before the first reply.
    reply: Option<sm2_node::Reply<[u8]>>,
    copy: AlignedCopy,
}

// A program may pass calls and replies to other threads, as the header says.
const _: fn() = || {
    fn can_be_shared<T: Send + Sync>() {}
    can_be_shared::<Reply>();
    fn can_be_sent<T: Send>() {}
    can_be_sent::<Call>();
};

impl Call {
    pub(crate) fn pending(&self) -> Result<&sm2_node::Call<[u8]>, Failure> {
        self.call.as_ref().ok_or_else(Self::spent)
    }

    fn spent() -> Failure {
        Failure::misuse("the call is spent: its result was returned; send another one")
    }
}

impl Reply {
    fn held(&self) -> Result<&sm2_node::Reply<[u8]>, Failure> {
        (self.reply.as_ref()).ok_or_else(|| {
            Failure::misuse("the reply is empty: no call has stored a reply in it since")
        })
    }

    /// Stores a reply in its place. The handle is used again, if there is one.
    fn store(place: &mut Option<Box<Self>>, reply: sm2_node::Reply<[u8]>) {
        let place = place.get_or_insert_default();
        place.copy.align(&reply);
        place.reply = Some(reply);
    }

    /// Checks the place of a reply, and releases an earlier one in it.
    fn vacated(place: Option<&mut Option<Box<Self>>>) -> Result<&mut Option<Box<Self>>, Failure> {
        let place = given(place, "reply")?;
        if let Some(earlier) = place {
            earlier.reply = None;
        }
        Ok(place)
    }
}

/// Declares a client. `request` and `reply` are the types of requests and replies, both NULL for raw bytes. `options`
/// is NULL for the defaults.
///
/// Errors: `SM2_TYPE_MISMATCH`, `SM2_BAD_NAME`, `SM2_BAD_SCHEMA`, `SM2_BAD_QOS`, `SM2_NO_MANAGER`, `SM2_REFUSED`,
/// `SM2_QUOTA`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_client_new(
    node: Option<&Node>,
    service: *const c_char,
    request: *const Type,
    reply: *const Type,
    options: *const ClientOptions,
    client: Option<&mut MaybeUninit<Option<Box<Client>>>>,
) -> Status {
    guard(|| {
        let client = vacant(client, "client")?;
        let node = &given(node, "node")?.0;
        let service = Text(service);
        let options = In(options).read_or(ClientOptions::defaults)?;
        let mut builder: ClientBuilder<[u8], [u8]> =
            node.client_builder(service.required("service")?);
        if let Some((request, reply)) = service_types(node, request, reply)? {
            builder = builder.type_ids(request, reply);
        }
        let declared = options.apply(builder)?.declare();
        let declared = declared.map_err(|error| not_declared(node, error))?;
        *client = Some(Box::new(Client(declared)));
        Ok(())
    })
}

/// Frees a client; NULL is ignored. Its pending calls and replies keep it declared until they are freed.
///
/// Threads: any, but no other call may use this handle at the same time or later.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_client_free(client: Option<Box<Client>>) {
    guard_drop(client);
}

/// Waits until at least `count` servers are linked, for at most `timeout_ns` nanoseconds (`SM2_FOREVER`: no limit).
///
/// Errors: `SM2_TIMED_OUT`, `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_client_wait_for_servers(
    client: Option<&Client>,
    count: usize,
    timeout_ns: u64,
) -> Status {
    guard(|| {
        let client = &given(client, "client")?.0;
        match timeout_ns {
            FOREVER => client.wait_for_servers(count)?,
            ns => client.wait_for_servers_timeout(count, duration(ns))?,
        }
        Ok(())
    })
}

/// Sends the `len` bytes at `data` to a server, and waits for the reply for at most `timeout_ns` nanoseconds
/// (`SM2_FOREVER`: no limit). The server learns the deadline. If it ends, the call fails at once.
///
/// `*reply` is NULL, or a reply of an earlier call, which is released first; the handle is used again.
///
/// Errors: `SM2_NO_SERVER`, `SM2_SERVER_GONE`, `SM2_DEADLINE_EXCEEDED`, `SM2_CALL_FAILED`, `SM2_BORROW_LIMIT`,
/// `SM2_TOO_LONG`, `SM2_POOL_FULL`, `SM2_UNREADABLE`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time with other replies.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_client_call(
    client: Option<&Client>,
    data: *const c_void,
    len: usize,
    timeout_ns: u64,
    reply: Option<&mut Option<Box<Reply>>>,
) -> Status {
    guard(|| {
        let reply = Reply::vacated(reply)?;
        let client = &given(client, "client")?.0;
        let data = Bytes(data);
        let request = data.slice(len, "data")?;
        let received = match timeout_ns {
            FOREVER => client.call(request)?,
            ns => client.call_timeout(request, duration(ns))?,
        };
        Reply::store(reply, received);
        Ok(())
    })
}

/// Sends the `len` bytes at `data` to a server, with a deadline of `timeout_ns` nanoseconds from now (`SM2_FOREVER`:
/// none). The reply is fetched with `sm2_call_wait()` or `sm2_call_try_wait()`, or with a wait set.
///
/// Returns at once, except while the link to the first server is being opened. `*call` is NULL, or an earlier call,
/// which is cancelled if it is pending; the handle is used again.
///
/// Errors: `SM2_NO_SERVER`, `SM2_DEADLINE_EXCEEDED`, `SM2_BORROW_LIMIT`, `SM2_TOO_LONG`, `SM2_POOL_FULL`,
/// `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time with other calls.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_client_send(
    client: Option<&Client>,
    data: *const c_void,
    len: usize,
    timeout_ns: u64,
    call: Option<&mut Option<Box<Call>>>,
) -> Status {
    guard(|| {
        let place = given(call, "call")?;
        let client = &given(client, "client")?.0;
        let data = Bytes(data);
        let request = data.slice(len, "data")?;
        if let Some(earlier) = place {
            earlier.call = None;
        }
        let sent = match timeout_ns {
            FOREVER => client.send(request)?,
            ns => client.send_timeout(request, duration(ns))?,
        };
        place.get_or_insert_default().call = Some(sent);
        Ok(())
    })
}

/// Stores a descriptor in `fd` that is readable when `sm2_call_try_wait()` of a pending call may have a result. The
/// client keeps the descriptor; do not close it.
///
/// Errors: `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_client_descriptor(
    client: Option<&Client>,
    fd: Option<&mut MaybeUninit<c_int>>,
) -> Status {
    guard(|| store_descriptor(&given(client, "client")?.0, fd))
}

/// Explains why the client has no links: stores a text in `text`, with a line for each server that comes close. The
/// text is empty if there is none. Free it with `sm2_text_free()`.
///
/// Errors: `SM2_NO_MANAGER`, `SM2_SHUTDOWN`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_client_why(
    client: Option<&Client>,
    text: Option<&mut MaybeUninit<*mut c_char>>,
) -> Status {
    guard(|| why(text, || Ok(given(client, "client")?.0.why()?)))
}

/// Waits for the reply of a call, until its deadline if it has one. The call is spent then, also after an error.
///
/// `*reply` is NULL, or a reply of an earlier call, which is released first; the handle is used again.
///
/// Errors: those of `sm2_client_call()`, and `SM2_CANCELLED`; `SM2_MISUSE` also if the call is spent.
///
/// Threads: one at a time for each call, and for each reply.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_call_wait(
    call: Option<&mut Call>,
    reply: Option<&mut Option<Box<Reply>>>,
) -> Status {
    guard(|| {
        let reply = Reply::vacated(reply)?;
        let call = given(call, "call")?.call.take().ok_or_else(Call::spent)?;
        Reply::store(reply, call.wait()?);
        Ok(())
    })
}

/// Stores the reply of a call if it has arrived, and does not wait: `SM2_TIMED_OUT` if the call is still pending. The
/// call is spent after a reply and after every other error.
///
/// Errors: those of `sm2_call_wait()`, and `SM2_TIMED_OUT`.
///
/// Threads: one at a time for each call, and for each reply.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_call_try_wait(
    call: Option<&mut Call>,
    reply: Option<&mut Option<Box<Reply>>>,
) -> Status {
    guard(|| {
        let reply = Reply::vacated(reply)?;
        let call = given(call, "call")?;
        let result = call.call.as_mut().ok_or_else(Call::spent)?.try_wait();
        if !matches!(result, Ok(None)) {
            call.call = None;
        }
        Reply::store(reply, result?.ok_or(Failure::TIMED_OUT)?);
        Ok(())
    })
}

/// Cancels a call at its server. Waiting for it then ends with `SM2_CANCELLED`, or with the reply if that arrives
/// first.
///
/// Errors: `SM2_MISUSE`, also if the call is spent.
///
/// Threads: one at a time for each call.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_call_cancel(call: Option<&Call>) -> Status {
    guard(|| {
        given(call, "call")?.pending()?.cancel();
        Ok(())
    })
}

/// Frees a call, which is cancelled if it is pending; NULL is ignored.
///
/// Threads: any, but no other call may use this handle at the same time or later.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_call_free(call: Option<Box<Call>>) {
    guard_drop(call);
}

/// Stores the bytes of a reply in `data`, and their number in `len`. They are aligned to 64 bytes, and do not change
/// until the reply is freed or used again.
///
/// Errors: `SM2_MISUSE`, also if the reply is empty.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_reply_data(
    reply: Option<&Reply>,
    data: Option<&mut MaybeUninit<*const c_void>>,
    len: Option<&mut MaybeUninit<usize>>,
) -> Status {
    guard(|| {
        let reply = given(reply, "reply")?;
        let bytes = reply.copy.of(reply.held()?);
        store_bytes(bytes, data, "data", len)
    })
}

/// Stores the name of the server's node in `server`, and its length in `len`. The text has no NUL at its end, and is
/// valid as long as the reply.
///
/// Errors: `SM2_MISUSE`, also if the reply is empty.
///
/// Threads: any, at the same time.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_reply_server(
    reply: Option<&Reply>,
    server: Option<&mut MaybeUninit<*const c_char>>,
    len: Option<&mut MaybeUninit<usize>>,
) -> Status {
    guard(|| {
        let name = given(reply, "reply")?.held()?.server().as_str();
        store_bytes(name.as_bytes(), server, "server", len)
    })
}

/// Frees a reply; NULL is ignored.
///
/// Threads: any, but no other call may use this handle at the same time or later.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_reply_free(reply: Option<Box<Reply>>) {
    guard_drop(reply);
}
