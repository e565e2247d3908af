//! A peer that stops reading. `silence` has it in virtual time.

use quinn_proto::{TransportConfig, VarInt};
use sm2_proto::{Name, TypeId, gateway::PeerFarewell};

use super::bench::{Bench, EPOCH, hello};

/// 3,000 offers with names and types of 250 bytes do not fit into 1 MiB.
//= SM2-GWF-003 test
#[test]
fn a_peer_that_does_not_read_the_control_stream_is_closed() {
    let mut bench = Bench::new();
    let data = TypeId {
        name: Name::new(&"t".repeat(250)).unwrap(),
        hash: 1,
    };
    let mut publishers = Vec::new();
    for number in 0..3_000 {
        if number % 1_000 == 0 {
            publishers.push((bench.near.node(&format!("talker-{number}")), Vec::new()));
        }
        let (node, of_node) = publishers.last_mut().unwrap();
        let topic = format!("{}{number:04}", "n".repeat(246));
        let builder = node.publisher_builder::<[u8]>(&topic);
        of_node.push(builder.type_id(data.clone()).declare().unwrap());
    }
    // Connects only now: while this thread declares, it does not acknowledge packets.
    let transport = || {
        let mut transport = TransportConfig::default();
        transport.stream_receive_window(VarInt::from_u32(1_000));
        transport
    };
    let closed = bench.closed_with(transport, "stalled", |it| {
        it.is_deaf = true;
        it.frame(&hello(EPOCH));
    });
    assert_eq!(closed, u64::from(PeerFarewell::Stalled.code().0));
    bench.is_undisturbed();
    bench.stop();
}
