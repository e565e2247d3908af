//! Harness for the first frame of a link.

use crate::{
    Datagram, Instant, LinkId, VERSION, Violation,
    limits::WINDOW_MAX,
    link::{
        Link, Publications, Role,
        phase::Phase,
        proofs::{config, role},
        wire::{Frame, Open},
    },
    proofs::one_of,
};

/// 2^40 bytes in the units of `max_len`.
const MAX_LEN_UNITS: u32 = 1 << 30;

/// Each legal and illegal `window` and `max_len`, with a value of the other field that is legal for
/// some role.
const SIZES: [(u32, u32); 6] = [
    (0, 0),
    (0, 1),
    (1, 0),
    (1, MAX_LEN_UNITS + 1),
    (WINDOW_MAX, MAX_LEN_UNITS),
    (WINDOW_MAX + 1, 1),
];

/// The outcome of OPEN for an end in this role; `named` says whether the link, version and role are right.
fn legal(role: Role, open: &Open, named: bool) -> Result<(), Violation> {
    let window = if role == Role::Receiver {
        open.window == 0
    } else {
        (1..=2_048).contains(&open.window)
    };
    let is_accepting = if role == Role::Receiver {
        open.max_len == 0
    } else {
        (1..=MAX_LEN_UNITS).contains(&open.max_len)
    };
    let Publications {
        publisher,
        published,
    } = open.publications;
    let says = match role {
        Role::Receiver => publisher != 0 || published == 0,
        Role::Sender | Role::Caller | Role::Server => publisher == 0 && published == 0,
    };
    if !named {
        Err(violation!(BadOpen, "SM2-OPN-002"))
    } else if !window {
        Err(violation!(BadWindow, "SM2-OPN-003"))
    } else if open.lanes & 1 == 0 {
        Err(violation!(BadOpen, "SM2-OPN-004"))
    } else if !is_accepting {
        Err(violation!(BadOpen, "SM2-OPN-005"))
    } else if !says {
        Err(violation!(BadOpen, "SM2-OPN-006"))
    } else {
        Ok(())
    }
}

/// The first OPEN opens the link exactly if each of its fields is legal. Otherwise nothing changes.
//= SM2-OPN-002, SM2-OPN-003, SM2-OPN-004, SM2-OPN-005, SM2-OPN-006 kani
// Shows LNK-PHASE (Exhaustive), bound: any role byte; windows and lanes around their limits.
#[cfg_attr(kani, kani::proof)]
// 48 bytes of OPEN; twelve kinds of frames.
#[cfg_attr(kani, kani::unwind(50))]
fn open_is_checked() {
    let mut link = Link::new(config(role()));
    let ours = *link.config();
    let (right_link, right_version): (bool, bool) = kani::any();
    let (window, max_len) = one_of(&SIZES);
    let open = Open {
        role: kani::any(),
        version: VERSION + u16::from(!right_version),
        window,
        link: if right_link { ours.id } else { LinkId::FIRST },
        lanes: one_of(&[0, 1, 3]),
        max_len,
        publications: Publications {
            publisher: one_of(&[0, 1, u64::MAX]),
            published: one_of(&[0, 1]),
        },
    };
    // SPEC section 7: sender and receiver are counterparts, and so are caller and server.
    let theirs = [1, 0, 3, 2][ours.role as usize];
    let named = open.role == theirs && right_link && right_version;
    let expected = legal(ours.role, &open, named);
    let before = link.clone();
    let bytes = Frame::Open(open).head();
    let verdict = link.receive(Instant(0), Phase::Opening, &Datagram::new(&bytes));
    assert_eq!(verdict, expected);
    assert_eq!(link.is_open(), expected.is_ok());
    assert!(expected.is_ok() || link == before);
    kani::cover!(
        expected.is_ok() && open.lanes == 3,
        "with a lane that is unknown"
    );
    kani::cover!(
        expected == Err(violation!(BadWindow, "SM2-OPN-003")),
        "a window that is too large"
    );
    kani::cover!(
        expected == Err(violation!(BadOpen, "SM2-OPN-005")) && ours.role == Role::Sender,
        "a maximum length that is out of its range"
    );
    kani::cover!(
        expected == Err(violation!(BadOpen, "SM2-OPN-006")) && ours.role == Role::Sender,
        "a receiver with a number of publications"
    );
    if expected.is_ok() {
        assert_eq!(link.peer_publications(), open.publications);
    }
    if expected.is_ok() && ours.role.sends() {
        assert_eq!(link.peer_max_len(), 1_024 * u64::from(open.max_len));
    }
}

#[cfg(test)]
kani::explored! {
    open_is_checked: 4,
}
