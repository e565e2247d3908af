//! The work of a domain while a call fails.

use std::time::Duration;

use sm2_node::{Client, Node, Publisher, Server, Subscriber};

use sm2_test_support::until;

use super::{
    topic::Topic,
    world::{World, patient},
};

/// A message that fits into a packet, and one that does not.
pub(crate) const LENGTHS: [usize; 2] = [40, 100_000];

fn publisher(node: &Node) -> Publisher<[u8]> {
    patient("a publisher", || node.publisher("topic"))
}

fn subscriber(node: &Node) -> Subscriber<[u8]> {
    patient("a subscriber", || node.subscriber("topic"))
}

/// Messages through a ring.
pub(crate) fn ring(world: &mut World) {
    on_lane(world, true);
}

/// Messages through the link's socket.
pub(crate) fn socket(world: &mut World) {
    on_lane(world, false);
}

fn on_lane(world: &mut World, ring: bool) {
    let (talker, listener) = (world.node("talker", ring), world.node("listener", ring));
    let mut topic = Topic::new(publisher(&talker), subscriber(&listener)).linked();
    for len in LENGTHS {
        topic.carry(world, len);
    }
    topic.adds_up();
}

/// Messages in sealed files.
pub(crate) fn sealed(world: &mut World) {
    let (talker, listener) = (world.node("talker", true), world.node("listener", true));
    let subscriber = patient("a subscriber", || {
        let builder = listener.subscriber_builder("topic");
        builder.sealed(true).declare()
    });
    let mut topic = Topic::new(publisher(&talker), subscriber).linked();
    for len in LENGTHS {
        topic.carry(world, len);
    }
    topic.adds_up();
}

/// A message from before the subscriber came.
pub(crate) fn latched(world: &mut World) {
    let (talker, listener) = (world.node("talker", true), world.node("listener", true));
    let publisher = patient("a publisher", || {
        talker
            .publisher_builder::<[u8]>("topic")
            .latched(1)
            .declare()
    });
    let serial = world.next_serial();
    let bytes = [
        &serial.to_le_bytes()[..],
        &sm2_tests::pattern::message(serial, LENGTHS[1]),
    ]
    .concat();
    patient("publish", || publisher.publish(&bytes[..]));
    let mut topic = Topic::new(publisher, subscriber(&listener));
    topic.note_sent(serial);
    until("the latched message", || topic.takes(serial));
    topic.adds_up();
}

/// A request and its reply.
pub(crate) fn call(world: &mut World) {
    let (asker, worker) = (world.node("asker", true), world.node("worker", true));
    let server: Server<[u8], [u8]> = patient("a server", || worker.server("service"));
    let client: Client<[u8], [u8]> = patient("a client", || asker.client("service"));
    for len in LENGTHS {
        let request = sm2_tests::pattern::message(len as u64, len);
        until("a reply", || {
            let asked = client.send_timeout(&request[..], Duration::from_millis(2));
            let Ok(mut call) = asked else {
                let _ = server.try_recv();
                return false;
            };
            for _ in 0..20 {
                if let Ok(Some(came)) = server.recv_timeout(Duration::from_millis(1)) {
                    assert!(*came == *request);
                    // The client asks again if the reply cannot be sent.
                    let _ = came.reply(&request[..]);
                }
                match call.try_wait() {
                    Ok(Some(reply)) => {
                        assert!(*reply == *request);
                        return true;
                    }
                    Ok(None) => {}
                    Err(_) => return false,
                }
            }
            false
        });
    }
}

/// Another Manager takes the domain over. The link stays, and new ones are made.
pub(crate) fn change(world: &mut World) {
    let (talker, listener) = (world.node("talker", true), world.node("listener", true));
    let mut topic = Topic::new(publisher(&talker), subscriber(&listener)).linked();
    topic.carry(world, LENGTHS[0]);
    world.stop_manager();
    // A link that is lost now is made again only by the next Manager.
    topic.send(world, LENGTHS[0]);
    world.start_manager();
    let late = patient("a late subscriber", || {
        listener.subscriber_builder::<[u8]>("topic").declare()
    });
    until("a link with the late subscriber", || {
        topic.publisher.links();
        late.links().iter().any(|it| it.open)
    });
    topic.carry(world, LENGTHS[1]);
    topic.adds_up();
}
