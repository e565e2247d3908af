//! How a link begins and ends: SPEC section 6, and the contract of the machine.

use crate::link_support::*;
use sm2_proto::{
    Code, Contract, Datagram, DemandedQos, Farewell, LinkId, Machine, Name, OfferedQos, Period,
    ServiceQos, TypeId,
    limits::QOS_MAX,
    link::{
        Config, End, Error, Fate, Input, Link, MaxLen, Misuse, NoMemory, Output, Publications,
        Role,
        wire::{Frame, Given, Open},
    },
};

//= SM2-OPN-001, SM2-OPN-002, SM2-OPN-003, SM2-OPN-004 test
#[test]
fn the_first_output_is_open_with_the_terms_of_this_end() {
    for (role, number, window) in [
        (Role::Sender, 0, 0),
        (Role::Receiver, 1, 3),
        (Role::Caller, 2, 3),
        (Role::Server, 3, 3),
    ] {
        let mut link = Link::new(config(role));
        let Some(Output::Transmit(packet)) = link.poll() else {
            panic!("{role:?}")
        };
        let open = Open {
            role: number,
            version: 1,
            window,
            link: LINK,
            lanes: 1,
            max_len: if window == 0 { 0 } else { 1 << 30 },
            publications: Publications::UNKNOWN,
        };
        assert_eq!(packet.to_vec(), Frame::Open(open).to_vec());
        assert_eq!((packet.attachment, link.poll()), (None, None));
        assert!(!link.is_open());
    }
}

//= SM2-OPN-001 test
#[test]
fn nothing_but_open_is_sent_before_the_other_ends_open() {
    let config = config(Role::Sender);
    let mut link = Link::new(config);
    drain(&mut link);
    assert_eq!(send(&mut link, message(1)), []);
    let outputs = accept(&mut link, &open_to(&config));
    assert_eq!(outputs[0], Output::Opened);
    assert_eq!(sent(&outputs).len(), 1);
    assert!(link.is_open());
}

/// A sender with three messages in flight and one waiting.
fn busy_sender() -> Link {
    let mut link = opened(config(Role::Sender));
    for id in 1..=4 {
        send(&mut link, message(id));
    }
    link
}

//= SM2-OPN-007, SM2-OPN-009 test
#[test]
fn closing_says_so_settles_all_and_is_last() {
    let mut link = busy_sender();
    let end = End::Local(Farewell::Done.code());
    assert_eq!(
        link.handle(NOW, Input::Close(Farewell::Done.code())),
        Ok(())
    );
    let outputs = drain(&mut link);
    assert_eq!(
        sent(&outputs[..1])[0].to_vec(),
        Frame::Close(Code(0)).to_vec()
    );
    assert_eq!(
        settled(&outputs),
        [1, 2, 3, 4].map(|key| (key, Fate::Closed))
    );
    assert_eq!(outputs.last(), Some(&Output::Ended(end)));
    assert_eq!(outputs.len(), 6);
    assert_eq!(
        (link.end(), link.in_flight(), link.has_room(&NoMemory)),
        (Some(end), 0, false)
    );
    assert_eq!(link.counters().closed, 4);
}

//= SM2-OPN-007, SM2-OPN-009, SM2-COD-001 test
#[test]
fn close_from_the_other_end_is_not_answered() {
    for code in [0, 5, 71, 999, u16::MAX] {
        let mut link = busy_sender();
        let outputs = accept(&mut link, &Frame::Close(Code(code)));
        assert_eq!(sent(&outputs), []);
        assert_eq!(settled(&outputs).len(), 4);
        assert_eq!(outputs.last(), Some(&Output::Ended(End::Peer(Code(code)))));
    }
}

//= SM2-TRN-003, SM2-OPN-009 test
#[test]
fn the_end_of_the_stream_and_a_read_of_nothing_are_the_same() {
    for input in [Input::Eof, Input::Datagram(Datagram::new(&[]))] {
        let mut link = busy_sender();
        assert_eq!(link.handle(NOW, input), Ok(()));
        let outputs = drain(&mut link);
        assert_eq!(sent(&outputs), []);
        assert_eq!(settled(&outputs).len(), 4);
        assert_eq!(outputs.last(), Some(&Output::Ended(End::Eof)));
    }
}

//= SM2-OPN-007 test
#[test]
fn what_came_before_the_end_can_be_taken_after_it() {
    let mut link = opened(config(Role::Receiver));
    accept(&mut link, &data(1, 1));
    accept(&mut link, &data(2, 2));
    accept(&mut link, &Frame::Close(Code(0)));
    assert_eq!(link.take(&NoMemory).unwrap().unwrap().sequence, 1);
    assert!(link.take(&NoMemory).is_err(), "one at a time, as ever");
    let released = give_back(&mut link, 1);
    assert_eq!(released, Err(Error::Ended(End::Peer(Code(0)))));
    assert_eq!(link.take(&NoMemory).unwrap().unwrap().sequence, 2);
    assert_eq!(link.take(&NoMemory), Ok(None));
    assert_eq!(link.poll(), None, "nothing is sent after the end");
}

#[test]
fn a_blocked_link_sends_nothing_until_it_is_writable() {
    let config = reliable(Role::Caller);
    let mut link = opened(config);
    send(&mut link, message(1));
    accept(&mut link, &reply(1, 1));
    let taken = link.take(&NoMemory).unwrap().unwrap();
    link.handle(NOW, Input::Blocked).unwrap();
    give_back(&mut link, taken.sequence).unwrap();
    send(&mut link, message(2));
    link.handle(NOW, Input::Cancel { call: 2 }).unwrap();
    assert_eq!(drain(&mut link), []);
    link.handle(NOW, Input::Writable).unwrap();
    assert_eq!(sent(&drain(&mut link)).len(), 3);
}

#[test]
fn a_close_that_was_not_polled_is_dropped_when_the_socket_blocks() {
    let mut link = opened(config(Role::Sender));
    link.handle(NOW, Input::Close(Code(0))).unwrap();
    let end = End::Local(Code(0));
    assert_eq!(link.handle(NOW, Input::Blocked), Err(Error::Ended(end)));
    assert_eq!(drain(&mut link), [Output::Ended(end)]);
}

/// A driver says of a publication only what it can know. Each fate has a count of its own, and all of them add up.
//= SM2-QOS-006 test
#[test]
fn a_publication_is_dropped_with_a_fate_that_the_driver_knows() {
    for fate in Fate::ALL {
        let mut link = opened(Config {
            reliable: true,
            ..config(Role::Sender)
        });
        let expected = match fate {
            Fate::Delivered | Fate::Discarded | Fate::Closed => Err(Misuse::WrongFate.into()),
            Fate::NoRoom => Err(Misuse::RoomLeft.into()),
            _ => Ok(()),
        };
        assert_eq!(link.handle(NOW, Input::Drop(fate)), expected, "{fate}");
        let (counters, dropped) = (link.counters(), u64::from(expected.is_ok()));
        assert_eq!((counters.offered, counters.of(fate)), (dropped, dropped));
        assert!(counters.is_balanced() && counters.dropped() == dropped);
    }
}

/// Calls and inputs that a role does not have are misuse.
#[test]
fn roles_have_their_inputs() {
    type Call = fn(&mut Link) -> Result<(), Error>;
    let all: [(&str, Call); 7] = [
        ("send", |link| offer(link, message(1))),
        ("no_room", |link| {
            link.handle(NOW, Input::Drop(Fate::NoRoom))
        }),
        ("overwritten", |link| {
            link.handle(NOW, Input::Drop(Fate::Overwritten))
        }),
        ("pool limit", |link| {
            link.handle(NOW, Input::Drop(Fate::PoolLimit))
        }),
        ("release", |link| give_back(link, 1)),
        ("cancel", |link| link.handle(NOW, Input::Cancel { call: 1 })),
        ("retire", |link| {
            link.handle(NOW, Input::Retire { segment: 1 })
        }),
    ];
    for (role, legal) in [
        (Role::Sender, [true, true, true, true, false, false, true]),
        (
            Role::Receiver,
            [false, false, false, false, true, false, false],
        ),
        (Role::Caller, [true, false, false, false, true, true, true]),
        (Role::Server, [true, false, false, false, true, false, true]),
    ] {
        for ((name, call), legal) in all.into_iter().zip(legal) {
            let mut link = opened(reliable(role));
            let before = link.clone();
            let refused = call(&mut link) == Err(Error::Misuse(Misuse::WrongRole));
            assert_eq!(!refused, legal, "{role:?}: {name}");
            assert!(legal || link == before);
        }
    }
}

/// A publisher, a subscriber, a client and a server.
fn contracts() -> [Contract; 4] {
    let name = |name: &str| Name::new(name).unwrap();
    let data = TypeId {
        name: name("bytes"),
        hash: 0,
    };
    let offer = OfferedQos {
        reliable: true,
        latched: 3,
        deadline: Period(11),
        lifespan: Period(12),
        lease: Period(14),
        ..OfferedQos::new(7)
    };
    let demand = DemandedQos {
        reliable: true,
        deadline: Period(13),
        lease: Period(15),
        ..DemandedQos::new(8, 4)
    };
    let qos = ServiceQos {
        depth: 9,
        max_borrowed: 2,
        sealed: false,
    };
    let (request, reply) = (data.clone(), data.clone());
    [
        Contract::Publisher {
            topic: name("t"),
            data: data.clone(),
            offer,
        },
        Contract::Subscriber {
            topic: name("t"),
            data: Some(data),
            demand,
        },
        Contract::Client {
            service: name("s"),
            types: None,
            qos,
        },
        Contract::Server {
            service: name("s"),
            request,
            reply,
            qos,
        },
    ]
}

#[test]
fn a_link_is_what_the_contract_says() {
    let contracts = contracts();
    let expected = [
        (7, 1, 11, 12, 0),
        (8, 4, 13, 0, 15),
        (9, 2, 0, 0, 0),
        (9, 2, 0, 0, 0),
    ];
    for ((contract, role), expected) in contracts.iter().zip(Role::ALL).zip(expected) {
        let (depth, max_borrowed, deadline, lifespan, lease) = expected;
        let id = LinkId {
            epoch: 1,
            serial: 2,
        };
        let config = Config::new(contract, id, 1, true, true);
        let same = Config {
            id,
            version: 1,
            role,
            reliable: true,
            sealed: true,
            ring: false,
            depth,
            max_borrowed,
            max_len: MaxLen::DEFAULT,
            deadline: Period(deadline),
            lifespan: Period(lifespan),
            lease: Period(lease),
            publications: Publications::UNKNOWN,
        };
        assert_eq!(config, same);
        assert_eq!(config.window(), contract.window());
        // A receiver learns the lifespan of its messages from the publisher.
        let of_peer = Period(if role == Role::Receiver { 12 } else { lifespan });
        assert_eq!(config.with_peer(&contracts[0]).lifespan, of_peer);
        // A sender learns from the subscriber whether it has to send ALIVE.
        let of_peer = Period(if role == Role::Sender { 15 } else { lease });
        assert_eq!(config.with_peer(&contracts[1]).lease, of_peer);
    }
}

#[test]
fn terms_out_of_range_are_brought_into_it() {
    let zero = Config {
        depth: 0,
        max_borrowed: 0,
        ..config(Role::Receiver)
    };
    assert_eq!(Link::new(zero).config().window(), 2);
    let huge = Config {
        depth: u16::MAX,
        max_borrowed: u16::MAX,
        ..zero
    };
    assert_eq!(Link::new(huge).config().window(), 2 * u32::from(QOS_MAX));
    assert!(Link::new(config(Role::Caller)).config().reliable);
}

#[test]
fn a_link_has_no_timer() {
    let mut link = busy_sender();
    assert_eq!(link.deadline(), None);
    release_all(&mut link, Given::Consumed, &[1]);
    assert_eq!(link.deadline(), None);
}
