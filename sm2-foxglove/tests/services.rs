//! Services of the domain, called by a viewer.

use std::thread;

use foxglove::ws_protocol::client::ServiceCallRequest;
use foxglove::ws_protocol::server::ServerMessage;
use serde_json::json;
use sm2_foxglove::Options;
use sm2_ros::std_srvs::srv::{SetBoolRequest, SetBoolResponse};
use sm2_test_support::SOON;

use crate::common::{Viewer, World};

/// Sends a request.
fn call(viewer: &mut Viewer, service_id: u32, call_id: u32, encoding: &str, payload: &[u8]) {
    viewer.send(&ServiceCallRequest {
        service_id,
        call_id,
        encoding: encoding.into(),
        payload: payload.into(),
    });
}

/// The reply of a call, and its encoding, or the reason why it has failed.
fn reply(viewer: &mut Viewer, call: u32) -> Result<(String, Vec<u8>), String> {
    viewer.wait(|message| match message {
        ServerMessage::ServiceCallResponse(it) if it.call_id == call => {
            Some(Ok((it.encoding.to_string(), it.payload.to_vec())))
        }
        ServerMessage::ServiceCallFailure(it) if it.call_id == call => {
            Some(Err(it.message.clone()))
        }
        _ => None,
    })
}

#[test]
fn a_service_of_ros_2_takes_cdr_and_json() {
    let world = World::new();
    let node = world.node("motor");
    let server = node
        .server::<SetBoolRequest, SetBoolResponse>("enable")
        .unwrap();
    let serving = thread::spawn(move || {
        for _ in 0..2 {
            let request = server.recv_timeout(SOON).unwrap().unwrap();
            let message = format!("got {}", request.data);
            let reply = SetBoolResponse {
                success: true,
                message,
            };
            request.reply(&reply).unwrap();
        }
        server
    });
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    assert_eq!(viewer.info.supported_encodings, ["cdr", "json"]);
    let service = viewer.service("enable");
    assert_eq!(service.r#type, "std_srvs/srv/SetBool");
    let request = service.request.unwrap();
    assert_eq!(
        (&*request.encoding, &*request.schema_encoding),
        ("cdr", "ros2msg")
    );
    assert_eq!(request.schema_name, "std_srvs/srv/SetBool_Request");
    assert_eq!(request.schema, "bool data\n");
    assert_eq!(
        service.response.unwrap().schema,
        "bool success\nstring message\n"
    );

    // `success`, three bytes of padding, and a text with its length and its final zero.
    let expected = |text: &str| {
        let len = text.len() as u8 + 1;
        [
            b"\0\x01\0\0\x01\0\0\0",
            &[len, 0, 0, 0][..],
            text.as_bytes(),
            b"\0",
        ]
        .concat()
    };
    call(&mut viewer, service.id, 7, "cdr", b"\0\x01\0\0\x01");
    let found = reply(&mut viewer, 7).unwrap();
    assert_eq!(found, ("cdr".to_owned(), expected("got true")));
    call(&mut viewer, service.id, 8, "json", br#"{"data":false}"#);
    let found = reply(&mut viewer, 8).unwrap();
    assert_eq!(found, ("cdr".to_owned(), expected("got false")));

    drop(serving.join().unwrap());
    viewer.no_service("enable");
    call(&mut viewer, service.id, 9, "cdr", b"\0\x01\0\0\x01");
    let error = reply(&mut viewer, 9).unwrap_err();
    assert_eq!(error, "there is no such service any more");
}

#[test]
fn other_services_take_json() {
    let world = World::new();
    let node = world.node("calculator");
    let server = node.server::<[f64], f64>("sum").unwrap();
    let serving = thread::spawn(move || {
        let request = server.recv_timeout(SOON).unwrap().unwrap();
        let sum = request.iter().sum();
        request.reply(&sum).unwrap();
        server
            .recv_timeout(SOON)
            .unwrap()
            .unwrap()
            .fail("out of numbers")
            .unwrap();
        server
    });
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    let service = viewer.service("sum");
    let request = service.request.unwrap();
    assert_eq!(
        (&*request.encoding, &*request.schema_encoding),
        ("json", "jsonschema")
    );
    let found: serde_json::Value = serde_json::from_str(&request.schema).unwrap();
    let items = json!({ "type": "array", "items": { "type": "number" } });
    assert_eq!(found["properties"], json!({ "value": items }));

    call(&mut viewer, service.id, 1, "json", br#"{"value":[1,2.5]}"#);
    let (encoding, payload) = reply(&mut viewer, 1).unwrap();
    assert_eq!((&*encoding, &*payload), ("json", &br#"{"value":3.5}"#[..]));
    for (call_id, payload) in [(2, &br#"{"value":"x"}"#[..]), (3, b"{"), (4, br#"{}"#)] {
        call(&mut viewer, service.id, call_id, "json", payload);
        let error = reply(&mut viewer, call_id).unwrap_err();
        assert!(!error.is_empty());
    }
    // The server sees only calls that can be encoded.
    call(&mut viewer, service.id, 5, "json", br#"{"value":[]}"#);
    assert!(
        reply(&mut viewer, 5)
            .unwrap_err()
            .contains("out of numbers")
    );
    drop(serving.join().unwrap());
}

#[test]
fn the_end_of_a_server_fails_its_calls() {
    let world = World::new();
    let node = world.node("calculator");
    let server = node.server::<[f64], f64>("sum").unwrap();
    let foxglove = world.foxglove(Options::default());
    let mut viewer = Viewer::connect(&foxglove.url);
    let service = viewer.service("sum");
    call(&mut viewer, service.id, 1, "json", br#"{"value":[1]}"#);
    let request = server.recv_timeout(SOON).unwrap().unwrap();
    drop((request, server, node));
    let error = reply(&mut viewer, 1).unwrap_err();
    assert!(error.contains("sum"), "{error}");
}
