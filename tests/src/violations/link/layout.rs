//! Frames of a wrong length, with reserved bytes set, or with values that no field has.

use sm2_proto::ViolationKind::{BadLength, Malformed, ReservedNotZero};

use super::stage::{
    Real::{Client, Publisher, Server, Subscriber},
    Rows, Rule, all,
};
use crate::{
    link::{Head, attach, cancel, close, detach, inline, kind, pooled, release, with_byte},
    memory,
};

pub(super) fn rows() -> Rows {
    let mut rows = lengths();
    rows.extend(reserved());
    rows.extend(values());
    rows
}

fn lengths() -> Rows {
    let head = Head::nth(kind::DATA, 1);
    let reply = Head::nth(kind::REPLY, 1).bytes();
    let short = Head { len: 2, ..head }.with(b"x");
    let long = Head { len: 1, ..head }.with(b"xy");
    let pooled = [pooled(kind::DATA, 1, 1, 0, 1), vec![0]].concat();
    let more = [release(0, &[1]), vec![0; 8]].concat();
    let fixed = Rule::new(BadLength, "SM2-WIR-001")
        .sent(Subscriber, "DETACH of 7 bytes", &detach(1)[..7])
        .sent(Subscriber, "CLOSE of 9 bytes", [close(0), vec![0]].concat())
        .sent(Subscriber, "CLOSE of 1 byte", [kind::CLOSE])
        .sent(Subscriber, "DATA of 47 bytes", &head.bytes()[..47])
        .sent(Client, "REPLY of 47 bytes", &reply[..47])
        .sent(Publisher, "RELEASE of 7 bytes", &release(0, &[])[..7])
        .sent(Server, "CANCEL of 15 bytes", &cancel(1)[..15])
        .fresh(Subscriber, "OPEN of 49 bytes", |stage| {
            stage.send([stage.greeting().bytes(), vec![0]].concat());
        })
        .open(Subscriber, "ATTACH of 20 bytes", |stage| {
            stage.send_fd(&attach(1, 4096, 1)[..20], &memory::segment(4096));
        });
    let varying = Rule::new(BadLength, "SM2-WIR-001")
        .sent(Subscriber, "inline DATA shorter than it says", short)
        .sent(Subscriber, "inline DATA longer than it says", long)
        .sent(Subscriber, "pooled DATA with a byte behind it", pooled)
        .sent(
            Publisher,
            "RELEASE shorter than it says",
            &release(0, &[1, 2])[..16],
        )
        .sent(Publisher, "RELEASE longer than it says", more);
    let inline = inline(kind::DATA, 1, &vec![0; 61_441]);
    let too_long = Rule::new(BadLength, "SM2-PAY-002");
    all([
        fixed,
        varying,
        too_long.sent(Subscriber, "61,441 inline bytes", inline),
    ])
}

fn reserved() -> Rows {
    let data = || inline(kind::DATA, 1, b"x");
    let request = inline(kind::REQUEST, 1, b"x");
    let frames = [
        (Subscriber, "DATA", 12, data()),
        (Subscriber, "status of DATA", 2, data()),
        (Subscriber, "segment of inline DATA", 4, data()),
        (Subscriber, "slot of inline DATA", 8, data()),
        (Subscriber, "DETACH", 3, detach(1)),
        (Subscriber, "CLOSE", 1, close(0)),
        (Subscriber, "CLOSE", 7, close(0)),
        (Publisher, "RELEASE", 4, release(0, &[1])),
        (Server, "CANCEL", 7, cancel(1)),
        (Server, "status of REQUEST", 2, request),
    ];
    let mut rule = Rule::new(ReservedNotZero, "SM2-WIR-001");
    for (real, what, offset, bytes) in frames {
        let what = format!("{what}, byte {offset}");
        rule = rule.sent(real, what, with_byte(bytes, offset, 1));
    }
    for offset in [1, 3, 20, 23] {
        let bytes = with_byte(attach(1, 4096, 1), offset, 1);
        rule = rule.open(Subscriber, format!("ATTACH, byte {offset}"), move |stage| {
            stage.send_fd(&bytes, &memory::segment(4096));
        });
    }
    all([rule])
}

fn values() -> Rows {
    let data = Head::nth(kind::DATA, 1);
    let request = Head::nth(kind::REQUEST, 1);
    let reply = Head::nth(kind::REPLY, 1);
    all([
        Rule::new(Malformed, "SM2-PAY-001")
            .sent(Subscriber, "form 3", Head { form: 3, ..data }.bytes())
            .sent(
                Server,
                "form 255",
                Head {
                    form: 255,
                    ..request
                }
                .bytes(),
            ),
        Rule::new(Malformed, "SM2-MSG-004").sent(Publisher, "fate 3", release(3, &[1])),
        Rule::new(Malformed, "SM2-SRV-002").sent(
            Client,
            "status 4",
            Head { status: 4, ..reply }.bytes(),
        ),
    ])
}
