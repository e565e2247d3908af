//! Harnesses for what all machines share: contracts, seals, codes, counters.
//!
//! Under `cargo kani` these are proofs; under `cargo test` a stand-in for the `kani` crate
//! runs them (`verification/README.md`).

use crate::{
    Code, Contract, Datagram, Demand, Farewell, Name, Offer, ServiceQos, TypeId, Violation,
    counters::{
        ENTRY_BYTES, ENTRY_FIELDS, Entry, MAX_ENTRIES, MAX_FILE_BYTES, RECENT, entries_in, field,
        recent_index,
    },
    limits::{DATAGRAM_MAX, WINDOW_MAX},
    match_contracts,
};

fn name(first: bool) -> Name {
    Name::new(if first { "a" } else { "b" }).expect("a legal name")
}

fn type_id(first: bool) -> TypeId {
    TypeId {
        name: name(true),
        hash: u64::from(first),
    }
}

fn contract(depth: u16, max_borrowed: u16) -> Contract {
    let (kind, reliable, sealed): ((bool, bool), bool, bool) = kani::any();
    let called = name(kani::any());
    let qos = ServiceQos {
        depth,
        max_borrowed,
        sealed,
    };
    match kind {
        (true, true) => Contract::Publisher {
            topic: called,
            data: type_id(kani::any()),
            offer: Offer {
                depth,
                reliable,
                latched: 0,
                sealed,
            },
        },
        (true, false) => Contract::Subscriber {
            topic: called,
            data: kani::any::<Option<bool>>().map(type_id),
            demand: Demand {
                depth,
                reliable,
                max_borrowed,
                sealed,
            },
        },
        (false, true) => Contract::Server {
            service: called,
            request: type_id(true),
            reply: type_id(kani::any()),
            qos,
        },
        (false, false) => Contract::Client {
            service: called,
            types: kani::any::<Option<bool>>().map(|reply| (type_id(true), type_id(reply))),
            qos,
        },
    }
}

//= SM2-MAT-001, SM2-MAT-003 kani
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(4))]
fn matching_is_symmetric() {
    let (one, other) = (contract(1, 1), contract(1, 1));
    let found = match_contracts(&one, &other);
    assert_eq!(found, match_contracts(&other, &one));
    let Ok(terms) = found else { return };
    assert!(one.kind().counterpart() == other.kind() && one.name() == other.name());
    assert!(one.types().is_none() || other.types().is_none() || one.types() == other.types());
    assert_eq!(terms.sealed, one.sealed() || other.sealed());
    if let (Contract::Publisher { offer, .. }, Contract::Subscriber { demand, .. }) = (&one, &other)
    {
        assert_eq!(terms.reliable, demand.reliable);
        assert!(offer.reliable || !demand.reliable);
        kani::cover!(terms.reliable && terms.sealed, "reliable and sealed");
        kani::cover!(other.types().is_none(), "takes any type");
    }
}

//= SM2-OPN-003, SM2-FRM-003 kani
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(4))]
fn legal_contracts_have_legal_windows() {
    // Beyond the range on both sides, without many values that say nothing new.
    let contract = contract(kani::any::<u16>() % 1_030, kani::any::<u16>() % 1_030);
    kani::assume(contract.check_qos().is_ok());
    let publishes = matches!(contract, Contract::Publisher { .. });
    assert_eq!(contract.window() == 0, publishes);
    assert!(contract.window() <= WINDOW_MAX);
    kani::cover!(contract.window() > 2, "more than the least window");
    kani::cover!(publishes, "a publisher");
}

//= SM2-CNT-003 kani
#[cfg_attr(kani, kani::proof)]
fn counter_files_are_whole() {
    let size_bytes: u64 = kani::any();
    let whole = size_bytes.is_multiple_of(ENTRY_BYTES);
    let in_range = (2 * ENTRY_BYTES..=MAX_FILE_BYTES).contains(&size_bytes);
    match entries_in(size_bytes) {
        Some(entries) => {
            assert!(whole && (1..=MAX_ENTRIES).contains(&entries));
            assert_eq!((u64::from(entries) + 1) * ENTRY_BYTES, size_bytes);
        }
        None => assert!(!whole || !in_range),
    }
    kani::cover!(whole && in_range, "a file");
    kani::cover!(in_range && !whole, "half an entry");
}

//= SM2-CNT-004 kani
#[cfg_attr(kani, kani::proof)]
fn recent_messages_follow_each_other() {
    let message = kani::any_where(|message: &u64| *message < u64::MAX);
    assert!(recent_index(message) < RECENT);
    let next = recent_index(message + 1);
    assert!(message == 0 || next == (recent_index(message) + 1) % RECENT);
    assert_eq!(recent_index(1), 0);
    kani::cover!(next == 0 && message > 0, "begins again");
}

//= SM2-CNT-004 kani
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(66))]
fn counter_entries_are_canonical() {
    let mut words = [0; ENTRY_FIELDS];
    words[field::TURN] = kani::any();
    words[field::KIND] = kani::any_where(|kind: &u64| *kind < 4);
    words[field::LINK_SERIAL] = kani::any();
    words[field::RESERVED + 13] = kani::any();
    words[field::DELAY_MAX] = kani::any();
    words[field::RECENT + RECENT - 1] = kani::any();
    let entry = Entry::from_words(&words);
    kani::cover!(entry.is_none(), "not an entry");
    let Some(entry) = entry else { return };
    assert!(words[field::TURN] % 2 == 0 && words[field::TURN] != 0);
    assert!(entry.to_words(words[field::TURN]) == words);
    kani::cover!(entry.link.is_some(), "a link");
}

//= SM2-COD-001 kani
#[cfg_attr(kani, kani::proof)]
fn codes_have_one_meaning() {
    let code = Code(kani::any());
    let (farewell, violation) = (Farewell::from_code(code), Violation::from_code(code));
    assert!(farewell.is_none() || violation.is_none());
    assert!(farewell.is_none_or(|it| it.code() == code));
    assert!(violation.is_none_or(|it| it.code() == code));
    kani::cover!(farewell.is_some(), "a farewell");
    kani::cover!(violation.is_some(), "a violation");
}

//= SM2-TRN-004, SM2-TRN-005 kani
#[cfg_attr(kani, kani::proof)]
fn truncated_datagrams_are_refused() {
    static BYTES: [u8; DATAGRAM_MAX + 1] = [0; DATAGRAM_MAX + 1];
    let len = kani::any_where(|len: &usize| *len <= BYTES.len());
    let (data_truncated, control_truncated) = kani::any();
    let datagram = Datagram {
        data_truncated,
        control_truncated,
        ..Datagram::new(&BYTES[..len])
    };
    let whole = !data_truncated && !control_truncated && len <= DATAGRAM_MAX;
    assert_eq!(datagram.check().is_ok(), whole);
    kani::cover!(whole && len > 1, "a whole datagram");
    kani::cover!(len > DATAGRAM_MAX && !data_truncated, "one byte too long");
}

#[cfg(test)]
kani::explored! {
    matching_is_symmetric: 2,
    legal_contracts_have_legal_windows: 2,
    counter_files_are_whole: 2,
    recent_messages_follow_each_other: 1,
    counter_entries_are_canonical: 2,
    codes_have_one_meaning: 2,
    truncated_datagrams_are_refused: 2,
}
