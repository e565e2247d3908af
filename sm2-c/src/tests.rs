//! The error convention, and arguments that are NULL: the tests call the functions as a C program does. All else is
//! tested by programs in C.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::mem::MaybeUninit;
use std::ptr::{null, null_mut};
use std::sync::{Arc, Barrier};
use std::thread;

use crate::arguments::{Bytes, In, Text};
use crate::client::*;
use crate::loan::*;
use crate::log::*;
use crate::node::*;
use crate::publisher::*;
use crate::qos::*;
use crate::report::*;
use crate::ros::*;
use crate::sample::*;
use crate::server::*;
use crate::shutdown::*;
use crate::status::*;
use crate::subscriber::*;
use crate::types::*;
use crate::wait_set::*;

/// The text of this thread's last error.
fn last_error() -> String {
    // SAFETY: the function returns a text that ends with NUL, which is valid until the next error of this thread.
    let text = unsafe { CStr::from_ptr(sm2_last_error()) };
    text.to_str().expect("a text in UTF-8").to_owned()
}

/// Checks that each call has reported a misuse.
fn are_misuses(calls: &[(&str, Status)]) {
    for (argument, status) in calls {
        assert_eq!(*status, Status::MISUSE, "{argument}");
    }
}

#[test]
fn functions_of_nodes_report_null() {
    let text: *const c_char = c"text".as_ptr();
    are_misuses(&[
        ("shutdown", sm2_shutdown_new(None)),
        ("shutdown", sm2_shutdown_request(None)),
        ("shutdown", sm2_shutdown_is_requested(None, None)),
        ("shutdown", sm2_shutdown_descriptor(None, None)),
        ("options", sm2_node_options_init(null_mut())),
        ("node", sm2_node_connect(text, null(), None)),
        ("node", sm2_node_wait_connected(None, 0)),
        ("node", sm2_node_spin_some(None)),
        ("node", sm2_node_descriptor(None, None)),
        ("schema", sm2_schema_hash(null(), None)),
        ("hash", sm2_schema_hash(c"plain:u8".as_ptr(), None)),
        ("schema", sm2_ros_schema(text, null(), None)),
        (
            "name",
            sm2_ros_schema(null(), null(), Some(&mut MaybeUninit::uninit())),
        ),
    ]);
}

/// The schema text of a type of ROS 2, or the error and its text.
fn ros_schema(name: &CStr, folder: Option<&CStr>) -> Result<String, (Status, String)> {
    let mut place = MaybeUninit::uninit();
    let folder = folder.map_or(null(), CStr::as_ptr);
    let status = sm2_ros_schema(name.as_ptr(), folder, Some(&mut place));
    // SAFETY: the function always writes to the place, if there is one.
    let text = unsafe { place.assume_init() };
    if status != Status::OK {
        assert!(text.is_null());
        return Err((status, last_error()));
    }
    // SAFETY: the text ends with NUL, and is not freed yet.
    let schema = unsafe { CStr::from_ptr(text) }.to_str().map(str::to_owned);
    sm2_text_free(text);
    Ok(schema.expect("a schema in UTF-8"))
}

#[test]
fn types_of_ros_2_have_schemas() {
    let text = ros_schema(c"std_msgs/msg/String", None).expect("a schema");
    assert!(
        text.starts_with("cdr:RIHS01_") && text.ends_with("string data\n"),
        "{text}"
    );
    let mut hash = MaybeUninit::uninit();
    let schema = std::ffi::CString::new(text).expect("a text without NUL");
    assert_eq!(
        sm2_schema_hash(schema.as_ptr(), Some(&mut hash)),
        Status::OK
    );

    let (status, text) = ros_schema(c"std_msgs/msg/Nothing", None).expect_err("no such type");
    assert_eq!(status, Status::BAD_SCHEMA);
    assert!(text.contains("std_msgs/msg/Nothing"), "{text}");
    let (status, text) = ros_schema(c"no name", None).expect_err("no name");
    assert_eq!(status, Status::BAD_NAME, "{text}");
    let folder = Some(c"/no/such/folder");
    let (status, text) = ros_schema(c"std_msgs/msg/String", folder).expect_err("no folder");
    assert_eq!((status, sm2_last_errno()), (Status::IO, 2), "{text}");

    // A definition of the program, which refers to a built-in one.
    let folder = std::env::temp_dir().join(format!("sm2-c-ros-{}", std::process::id()));
    let package = folder.join("my_msgs/msg");
    std::fs::create_dir_all(&package).expect("a folder");
    std::fs::write(package.join("Wheel.msg"), "std_msgs/Header header\n").expect("a file");
    let path = std::ffi::CString::new(folder.to_str().expect("UTF-8")).expect("no NUL");
    let text = ros_schema(c"my_msgs/msg/Wheel", Some(&path)).expect("a schema");
    assert!(text.contains("MSG: std_msgs/Header"), "{text}");
    std::fs::write(package.join("Wheel.msg"), "float64\n").expect("a file");
    let (status, text) = ros_schema(c"my_msgs/msg/Wheel", Some(&path)).expect_err("malformed");
    assert_eq!(status, Status::BAD_SCHEMA, "{text}");
    assert!(text.contains("Wheel.msg"), "{text}");
    std::fs::remove_dir_all(&folder).expect("the folder");
}

#[test]
fn functions_of_topics_report_null() {
    let text: *const c_char = c"text".as_ptr();
    let data: *const c_void = text.cast();
    are_misuses(&[
        ("options", sm2_publisher_options_init(null_mut())),
        ("options", sm2_subscriber_options_init(null_mut())),
        (
            "publisher",
            sm2_publisher_new(None, text, null(), null(), None),
        ),
        (
            "publisher",
            sm2_publisher_publish(None, data, 4, null_mut()),
        ),
        (
            "publisher",
            sm2_publisher_try_publish(None, data, 4, null_mut()),
        ),
        ("publisher", sm2_publisher_flush(None, 0)),
        ("publisher", sm2_publisher_wait_for_subscribers(None, 1, 0)),
        ("publisher", sm2_publisher_assert_liveliness(None)),
        ("counters", sm2_publisher_counters(None, null_mut())),
        ("text", sm2_publisher_why(None, None)),
        ("publisher", sm2_publisher_descriptor(None, None)),
        ("loan", sm2_publisher_loan(None, 1, None)),
        ("publisher", sm2_publisher_loan(None, 1, Some(&mut None))),
        ("loan", sm2_loan_data(None, None, None)),
        ("loan", sm2_loan_publish(None, null_mut())),
        (
            "subscriber",
            sm2_subscriber_new(None, text, null(), null(), None),
        ),
        ("sample", sm2_subscriber_recv(None, 0, None)),
        ("subscriber", sm2_subscriber_recv(None, 0, Some(&mut None))),
        ("subscriber", sm2_subscriber_wait_for_publishers(None, 1, 0)),
        ("subscriber", sm2_subscriber_descriptor(None, None)),
        ("counters", sm2_subscriber_counters(None, null_mut())),
        ("text", sm2_subscriber_why(None, None)),
        ("sample", sm2_sample_data(None, None, None)),
        ("info", sm2_sample_info(None, null_mut())),
        ("sample", sm2_sample_release(None)),
    ]);
    // Each call has the text of its own argument.
    assert_eq!(sm2_sample_release(None), Status::MISUSE);
    assert_eq!(last_error(), "the argument 'sample' is NULL: pass a value");
}

#[test]
fn functions_of_services_report_null() {
    let text: *const c_char = c"text".as_ptr();
    let data: *const c_void = text.cast();
    are_misuses(&[
        ("options", sm2_server_options_init(null_mut())),
        ("options", sm2_client_options_init(null_mut())),
        (
            "server",
            sm2_server_new(None, text, null(), null(), null(), None),
        ),
        ("request", sm2_server_recv(None, 0, None)),
        ("server", sm2_server_recv(None, 0, Some(&mut None))),
        ("server", sm2_server_wait_for_clients(None, 1, 0)),
        ("server", sm2_server_descriptor(None, None)),
        ("text", sm2_server_why(None, None)),
        ("request", sm2_request_data(None, None, None)),
        ("info", sm2_request_info(None, null_mut())),
        ("request", sm2_request_is_cancelled(None, None)),
        ("request", sm2_request_reply(None, data, 4)),
        ("request", sm2_request_fail(None, text)),
        (
            "client",
            sm2_client_new(None, text, null(), null(), null(), None),
        ),
        ("client", sm2_client_wait_for_servers(None, 1, 0)),
        ("reply", sm2_client_call(None, data, 4, 0, None)),
        ("client", sm2_client_call(None, data, 4, 0, Some(&mut None))),
        ("call", sm2_client_send(None, data, 4, 0, None)),
        ("client", sm2_client_send(None, data, 4, 0, Some(&mut None))),
        ("client", sm2_client_descriptor(None, None)),
        ("text", sm2_client_why(None, None)),
        ("reply", sm2_call_wait(None, None)),
        ("call", sm2_call_wait(None, Some(&mut None))),
        ("call", sm2_call_try_wait(None, Some(&mut None))),
        ("call", sm2_call_cancel(None)),
        ("reply", sm2_reply_data(None, None, None)),
        ("reply", sm2_reply_server(None, None, None)),
    ]);
}

#[test]
fn functions_of_wait_sets_report_null() {
    are_misuses(&[
        ("set", sm2_wait_set_new(None)),
        ("set", sm2_wait_set_add_subscriber(None, None, 1)),
        ("set", sm2_wait_set_add_server(None, None, 1)),
        ("set", sm2_wait_set_add_publisher(None, None, 1)),
        ("set", sm2_wait_set_add_call(None, None, 1)),
        ("set", sm2_wait_set_add_timer(None, 1, false, 1)),
        ("set", sm2_wait_set_add_timer_hz(None, 1, false, 1)),
        ("set", sm2_wait_set_add_timer_once(None, 1, 1)),
        ("set", sm2_wait_set_add_descriptor(None, 0, true, false, 1)),
        ("set", sm2_wait_set_end_with(None, None)),
        ("set", sm2_wait_set_drive(None, None)),
        ("set", sm2_wait_set_remove(None, 1)),
        ("ready", sm2_wait_set_wait(None, 0, null_mut())),
    ]);
}

#[test]
fn null_is_freed() {
    sm2_node_free(None);
    sm2_publisher_free(None);
    sm2_subscriber_free(None);
    sm2_sample_free(None);
    sm2_loan_free(None);
    sm2_server_free(None);
    sm2_request_free(None);
    sm2_client_free(None);
    sm2_call_free(None);
    sm2_reply_free(None);
    sm2_wait_set_free(None);
    sm2_shutdown_free(None);
    sm2_text_free(null_mut());
}

#[test]
fn a_panic_becomes_a_code_and_a_text() {
    assert_eq!(guard(|| panic!("at step {}", 3)), Status::PANIC);
    assert!(last_error().ends_with("at step 3"), "{}", last_error());
    assert_eq!(guard(|| panic!("a constant")), Status::PANIC);
    assert!(last_error().ends_with("a constant"), "{}", last_error());
}

#[test]
fn success_keeps_the_text_and_each_thread_has_its_own() {
    let both_failed = Arc::new(Barrier::new(2));
    let other = {
        let both_failed = Arc::clone(&both_failed);
        thread::spawn(move || {
            assert_eq!(last_error(), "");
            assert_eq!(
                guard(|| Err(Failure::misuse("of the other thread"))),
                Status::MISUSE
            );
            both_failed.wait();
            last_error()
        })
    };
    assert_eq!(
        guard(|| Err(Failure::misuse("with a\0NUL"))),
        Status::MISUSE
    );
    both_failed.wait();
    assert_eq!(guard(|| Ok(())), Status::OK);
    assert_eq!(last_error(), "with a?NUL");
    assert_eq!(sm2_last_errno(), 0);
    assert_eq!(
        other.join().expect("the other thread"),
        "of the other thread"
    );
}

#[test]
fn an_error_of_the_system_has_its_number() {
    let error = std::io::Error::from_raw_os_error(24);
    let text = error.to_string();
    assert_eq!(
        guard(|| Err(sm2_node::RecvError::Io(error).into())),
        Status::IO
    );
    assert_eq!(sm2_last_errno(), 24);
    assert_eq!(last_error(), format!("cannot wait for a message: {text}"));
}

#[test]
fn codes_of_the_header_have_their_names() {
    let header = include_str!("../include/sm2.h");
    let mut codes = 0;
    for line in header.lines() {
        let Some((name, number)) = line.trim().trim_end_matches(',').split_once(" = ") else {
            continue;
        };
        let Ok(number) = number.parse() else { continue };
        // SAFETY: the function returns a constant text.
        let found = unsafe { CStr::from_ptr(sm2_status_name(number)) };
        assert_eq!(found.to_str(), Ok(name));
        codes += 1;
    }
    assert!(codes > 20, "{codes} codes found");
    // SAFETY: as above.
    let unknown = unsafe { CStr::from_ptr(sm2_status_name(-7)) };
    assert_eq!(unknown, c"SM2_UNKNOWN");
}

#[test]
fn bytes_and_texts_are_checked() {
    assert_eq!(Bytes(null()).slice(0, "data").expect("no bytes"), b"");
    let failure = Bytes(null()).slice(1, "data").expect_err("NULL");
    assert_eq!(failure.text, "the argument 'data' is NULL: pass a value");
    let one: *const c_void = (&raw const *b"x").cast();
    let failure = Bytes(one)
        .slice(usize::MAX, "data")
        .expect_err("a length that no object has");
    assert_eq!(failure.status, Status::MISUSE);
    let failure = Text(c"\xff".as_ptr()).required("topic").map(str::to_owned);
    let failure = failure.expect_err("not UTF-8");
    assert_eq!(failure.text, "the text 'topic' is not UTF-8: \"\\xff\"");
}

#[test]
fn a_negative_descriptor_is_refused() {
    let mut set = MaybeUninit::uninit();
    assert_eq!(sm2_wait_set_new(Some(&mut set)), Status::OK);
    // SAFETY: the call has stored a handle.
    let mut set = unsafe { set.assume_init() };
    let no_descriptor: c_int = -1;
    let status = sm2_wait_set_add_descriptor(set.as_deref_mut(), no_descriptor, true, false, 1);
    assert_eq!(status, Status::MISUSE);
    let status = sm2_wait_set_add_descriptor(set.as_deref_mut(), 0, false, false, 1);
    assert_eq!(status, Status::MISUSE);
    // A tag is used once.
    let mut tick = || sm2_wait_set_add_timer(set.as_deref_mut(), 1, false, 5);
    assert_eq!((tick(), tick()), (Status::OK, Status::MISUSE));
    assert_eq!(sm2_wait_set_remove(set.as_deref_mut(), 5), Status::OK);
    assert_eq!(sm2_wait_set_remove(set.as_deref_mut(), 5), Status::MISUSE);
    sm2_wait_set_free(set);
}

#[test]
fn a_level_of_the_log_is_checked() {
    assert_eq!(sm2_log_to_stderr(0), Status::MISUSE);
    assert_eq!(sm2_log_to_stderr(6), Status::MISUSE);
}

#[test]
fn a_struct_without_a_size_is_refused() {
    let mut options = SubscriberOptions::defaults();
    options.size = 3;
    let read = In(&raw const options).read(SubscriberOptions::defaults);
    let text = read.expect_err("a wrong size").text;
    assert_eq!(
        text,
        "the field 'size' of a sm2_subscriber_options_t is 3: set it to sizeof(sm2_subscriber_options_t)"
    );
}

#[test]
fn the_tests_call_every_function() {
    let header = include_str!("../include/sm2.h");
    let tests = include_str!("tests.rs");
    let mut functions = 0;
    for line in header.lines().filter(|it| it.starts_with("sm2_status_t ")) {
        let (name, _) = line["sm2_status_t ".len()..]
            .split_once('(')
            .expect("a function");
        assert!(tests.contains(&format!("{name}(")), "{name} is not called");
        functions += 1;
    }
    assert!(functions > 60, "{functions} functions found");
}

/// The header states the defaults, so they are written down here as well.
#[test]
fn defaults_are_those_of_the_library() {
    let folder = std::env::temp_dir().join(format!("sm2-c-defaults-{}", std::process::id()));
    std::fs::create_dir(&folder).expect("a folder");
    let embedding = |name: &str| {
        let builder = sm2_node::Node::builder(name).socket(folder.join("socket"));
        builder.embed_manager(sm2_manager::Options::default())
    };
    let set = NodeOptions::defaults().apply(embedding("one"));
    let usual = format!("{:?}", embedding("one"));
    assert_eq!(format!("{:?}", set.expect("legal options")), usual);

    let node = embedding("one").connect().expect("a node");
    // Without the state of the node before it, which the node's thread changes at any time.
    let options = |text: String| {
        let name = text.rfind("name: \"").expect("the name of the interface");
        text[name..].to_owned()
    };
    let publisher = || node.publisher_builder::<[u8]>("topic");
    let set = PublisherOptions::defaults().apply(publisher());
    assert_eq!(
        options(format!("{:?}", set.expect("legal options"))),
        options(format!("{:?}", publisher()))
    );
    let subscriber = || node.subscriber_builder::<[u8]>("topic");
    let set = SubscriberOptions::defaults().apply(subscriber());
    assert_eq!(
        options(format!("{set:?}")),
        options(format!("{:?}", subscriber()))
    );
    let server = || node.server_builder::<[u8], [u8]>("service");
    let set = ServerOptions::defaults().apply(server());
    assert_eq!(
        options(format!("{:?}", set.expect("legal options"))),
        options(format!("{:?}", server()))
    );
    let client = || node.client_builder::<[u8], [u8]>("service");
    let set = ClientOptions::defaults().apply(client());
    assert_eq!(
        options(format!("{:?}", set.expect("legal options"))),
        options(format!("{:?}", client()))
    );
    drop(node);
    std::fs::remove_dir_all(&folder).expect("the folder");
}
