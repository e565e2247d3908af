//! Calls: a cancellation follows its request, and each call has one answer.

use bytes::Bytes;
use sm2_gateway::{
    hub::{LocalCommand, LocalEvent, Output, RequestId},
    peer::{Command, ConnectionId, Event, PeerCall, Reason},
};
use sm2_proto::gateway::{OfferId, Outcome, StreamToken, session::End};

use super::{greet, hop, hub, local, offered, service, tell, wanted};

fn request(call: u64, offer: u64) -> Event {
    Event::Request {
        call: PeerCall(StreamToken(call)),
        offer: OfferId(offer),
        deadline: None,
        payload: Bytes::new(),
    }
}

//= SM2-GWS-003 test
#[test]
fn a_call_that_is_not_wanted_any_more_is_cancelled_where_it_went() {
    let mut hub = hub();
    greet(&mut hub, 1, 9, 9);
    greet(&mut hub, 2, 3, 3);
    let (subject, present) = (service("near"), true);
    local(&mut hub, LocalEvent::Present { subject, present });
    tell(&mut hub, 2, wanted(1, 1));
    let said = tell(&mut hub, 2, request(8, 1));
    let [Output::Local(LocalCommand::Call { call, .. })] = said[..] else {
        panic!("{said:?}");
    };
    let said = tell(
        &mut hub,
        2,
        Event::Cancelled {
            call: PeerCall(StreamToken(8)),
        },
    );
    assert!(matches!(said[..], [Output::Local(LocalCommand::Cancel { call: it })] if it == call));
    // And a call that was passed on to another peer.
    offered(&mut hub, 1, 6, service("far"), &[9]);
    tell(&mut hub, 2, wanted(2, 1));
    let said = tell(&mut hub, 2, request(9, 2));
    let [
        Output::Peer {
            connection: ConnectionId(1),
            command: Command::Call { call, .. },
        },
    ] = said[..]
    else {
        panic!("{said:?}");
    };
    let said = tell(
        &mut hub,
        2,
        Event::Ended(Reason::Session(End::Closed(None))),
    );
    let forgotten = said.iter().any(|it| {
        matches!(it, Output::Peer { connection: ConnectionId(1), command: Command::Forget { call: t } } if *t == call)
    });
    assert!(forgotten, "{said:?}");
}

#[test]
fn a_call_has_one_answer_also_when_the_way_is_lost() {
    let mut hub = hub();
    greet(&mut hub, 1, 9, 9);
    offered(&mut hub, 1, 6, service("far"), &[9]);
    let ask = |request| LocalEvent::Request {
        request,
        subject: service("far"),
        origin: hop(9).gateway,
        deadline: None,
        payload: Bytes::new(),
    };
    local(&mut hub, ask(RequestId(1)));
    let said = tell(
        &mut hub,
        1,
        Event::Ended(Reason::Session(End::Closed(None))),
    );
    let answers = |said: &[Output]| {
        let of = |it: &Output| match it {
            Output::Local(LocalCommand::Reply {
                request, outcome, ..
            }) => Some((*request, *outcome)),
            _ => None,
        };
        said.iter().filter_map(of).collect::<Vec<_>>()
    };
    assert_eq!(answers(&said), [(RequestId(1), Outcome::Unreachable)]);
    let said = local(&mut hub, ask(RequestId(2)));
    assert_eq!(answers(&said), [(RequestId(2), Outcome::Unreachable)]);
}
