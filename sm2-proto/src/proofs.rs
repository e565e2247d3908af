//! Harnesses for the types that all machines share: contracts, seals, codes, counters.
//!
//! Under `cargo kani` these are proofs; under `cargo test` a stand-in for the `kani` crate
//! runs them (`verification/README.md`).

use core::time::Duration;

use crate::{
    Code, Contract, Datagram, DemandedQos, Farewell, FdFacts, Instant, Mismatch, Name, OfferedQos,
    Period, Seals, ServiceQos, TypeId, ViolationKind,
    counters::{
        ENTRY_BYTES, ENTRY_FIELDS, Entry, MAX_ENTRIES, MAX_FILE_BYTES, RECENT, Summary, entries_in,
        field, recent_index,
    },
    limits::{DATAGRAM_MAX, WINDOW_MAX},
    match_contracts,
};

/// Any index into this many elements, at most 256.
pub(crate) fn below(len: usize) -> usize {
    usize::from(kani::any_where(|at: &u8| usize::from(*at) < len))
}

/// Any of these values.
pub(crate) fn one_of<T: Clone>(all: &[T]) -> T {
    all[below(all.len())].clone()
}

fn name(first: bool) -> Name {
    Name::new(if first { "a" } else { "b" }).expect("a legal name")
}

fn type_id(first: bool) -> TypeId {
    TypeId {
        name: name(true),
        hash: u64::from(first),
    }
}

/// A subscriber for harnesses that do not depend on its contract.
pub(crate) fn subscriber() -> Contract {
    Contract::Subscriber {
        topic: name(true),
        data: None,
        demand: DemandedQos::new(1, 1),
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
            offer: OfferedQos {
                reliable,
                latched: max_borrowed,
                sealed,
                ..OfferedQos::new(depth)
            },
        },
        (true, false) => Contract::Subscriber {
            topic: called,
            data: kani::any::<Option<bool>>().map(type_id),
            demand: DemandedQos {
                reliable,
                sealed,
                ..DemandedQos::new(depth, max_borrowed)
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
// Shows MGR-MATCH (Exhaustive), bound: two names, two type hashes.
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

/// Two interfaces that match but for their deadlines match if the offer is there and not longer.
//= SM2-MAT-001, SM2-QOS-009 kani
// Shows MGR-MATCH (BoundariesAndSamples), bound: any deadlines.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(4))]
fn deadlines_decide_a_match() {
    let (offered, demanded) = kani::any();
    periods_decide_a_match([offered, 0], [demanded, 0], Mismatch::Deadline);
}

/// The same for leases.
//= SM2-MAT-001, SM2-QOS-011 kani
// Shows MGR-MATCH (BoundariesAndSamples), bound: any leases.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(4))]
fn leases_decide_a_match() {
    let (offered, demanded) = kani::any();
    periods_decide_a_match([0, offered], [0, demanded], Mismatch::Lease);
}

/// Matches interfaces with these deadlines and leases, where one kind is zero.
fn periods_decide_a_match(
    [offered_deadline, offered_lease]: [u64; 2],
    [demanded_deadline, demanded_lease]: [u64; 2],
    mismatch: Mismatch,
) {
    let publisher = Contract::Publisher {
        topic: name(true),
        data: type_id(true),
        offer: OfferedQos {
            deadline: Period(offered_deadline),
            lease: Period(offered_lease),
            ..OfferedQos::new(1)
        },
    };
    let mut subscriber = subscriber();
    if let Contract::Subscriber { demand, .. } = &mut subscriber {
        demand.deadline = Period(demanded_deadline);
        demand.lease = Period(demanded_lease);
    }
    let found = match_contracts(&publisher, &subscriber);
    assert_eq!(found, match_contracts(&subscriber, &publisher));
    let offered = offered_deadline + offered_lease;
    let demanded = demanded_deadline + demanded_lease;
    let is_fulfilled = demanded == 0 || (1..=demanded).contains(&offered);
    assert_eq!(found.err(), (!is_fulfilled).then_some(mismatch));
    kani::cover!(
        is_fulfilled && demanded > 0 && offered < demanded,
        "a shorter offer"
    );
    kani::cover!(!is_fulfilled && offered > 0, "a longer offer");
}

//= SM2-OPN-003, SM2-FRM-003 kani
// Shows QOS-WINDOW (BoundariesAndSamples), bound: depth and max_borrowed up to 1,029.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(4))]
fn legal_contracts_have_legal_windows() {
    // The second value of a publisher is `latched`, which may be zero.
    let (depth, other): (u16, u16) = kani::any();
    let contract = contract(depth, other);
    let publishes = matches!(contract, Contract::Publisher { .. });
    let depth_is_legal = (1..=1_024).contains(&depth);
    let legal = depth_is_legal && other <= 1_024 && (publishes || other > 0);
    assert_eq!(contract.check_qos().is_ok(), legal);
    if legal {
        assert_eq!(contract.window() == 0, publishes);
        assert!(contract.window() <= WINDOW_MAX);
        kani::cover!(contract.window() == WINDOW_MAX, "the largest window");
        kani::cover!(publishes && other == 0, "nothing is latched");
    }
}

//= SM2-CNT-004 kani
// Shows CNT-SIZE (BoundariesAndSamples), bound: any size.
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

//= SM2-CNT-005 kani
// Shows CNT-RECENT (BoundariesAndSamples), bound: any number.
#[cfg_attr(kani, kani::proof)]
fn recent_messages_follow_each_other() {
    let message = kani::any_where(|message: &u64| *message < u64::MAX);
    assert!(recent_index(message) < RECENT);
    let next = recent_index(message + 1);
    assert!(message == 0 || next == (recent_index(message) + 1) % RECENT);
    assert_eq!(recent_index(1), 0);
    kani::cover!(next == 0 && message > 0, "begins again");
}

//= SM2-CNT-005 kani
// Shows CNT-CANONICAL (Samples), bound: six of 64 words are free, the others zero.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(66))]
fn counter_entries_are_canonical() {
    let mut words = [0; ENTRY_FIELDS];
    words[field::TURN] = kani::any();
    words[field::KIND] = kani::any_where(|kind: &u64| *kind < 4);
    words[field::LINK_SERIAL] = kani::any();
    words[field::RECENT - 1] = kani::any();
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
// Shows COD-UNIQUE (Exhaustive), bound: none: any code.
#[cfg_attr(kani, kani::proof)]
fn codes_have_one_meaning() {
    let code = Code(kani::any());
    let (farewell, violation) = (Farewell::from_code(code), ViolationKind::from_code(code));
    assert!(farewell.is_none() || violation.is_none());
    assert!(farewell.is_none_or(|it| it.code() == code));
    assert!(violation.is_none_or(|it| it.code() == code));
    kani::cover!(farewell.is_some(), "a farewell");
    kani::cover!(violation.is_some(), "a violation");
}

//= SM2-TRN-004 kani
// Shows TRN-WHOLE (BoundariesAndSamples), bound: contents are zeros.
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
    let whole = !data_truncated && len <= DATAGRAM_MAX;
    assert_eq!(datagram.check().is_ok(), whole);
    kani::cover!(whole && len > 1, "a whole datagram");
    kani::cover!(len > DATAGRAM_MAX && !data_truncated, "one byte too long");
}

/// A datagram has exactly the number of descriptors that its type names. Only the receiver itself can
/// have lost some.
//= SM2-TRN-010, SM2-TRN-011 kani
// Shows TRN-WHOLE (Exhaustive), bound: up to 3.
#[cfg_attr(kani, kani::proof)]
fn descriptors_are_counted() {
    let files = [FdFacts::default(); 3];
    let (came, wanted) = (below(4), below(4));
    let some_lost: bool = kani::any();
    let datagram = Datagram {
        fds: &files[..came],
        control_truncated: some_lost,
        ..Datagram::new(&[1])
    };
    let expected = match (some_lost, came < wanted, came == wanted) {
        (true, true, _) | (false, _, true) => Ok(()),
        _ => Err(violation!(FdCount, "SM2-TRN-010")),
    };
    assert_eq!(datagram.check_fds(wanted), expected);
    assert_eq!(datagram.has_lost_fds(wanted), some_lost && came < wanted);
    kani::cover!(came > wanted && wanted > 0, "more than wanted");
    kani::cover!(!some_lost && came == wanted && came == 1, "one");
    kani::cover!(some_lost && came == 1 && wanted == 2, "one of two was lost");
}

/// A deadline is never before the moment when its time begins, and exact until the end of time.
//= SM2-SES-004, SM2-RES-006 kani
// Shows TIME-SATURATES (BoundariesAndSamples), bound: any moment and duration.
#[cfg_attr(kani, kani::proof)]
fn deadlines_saturate() {
    let now = Instant(kani::any());
    let nanos = kani::any_where(|nanos: &u32| *nanos < 1_000_000_000);
    let seconds: u64 = kani::any();
    let wait = Duration::new(seconds, nanos);
    let exact = u128::from(now.0) + 1_000_000_000 * u128::from(seconds) + u128::from(nanos);
    let deadline = now.after(wait);
    assert!(deadline >= now);
    match u64::try_from(exact) {
        Ok(exact) => {
            assert_eq!(deadline, Instant(exact));
            assert_eq!(deadline.since(now), wait);
            kani::cover!(seconds > 0 && nanos > 0, "exact");
        }
        Err(_) => {
            assert_eq!(deadline, Instant(u64::MAX));
            kani::cover!(true, "beyond the end of time");
        }
    }
    assert!(deadline == now || now.since(deadline).is_zero());
}

/// Every set of seals against every set that may be needed.
//= SM2-SEG-001, SM2-CNT-004 kani
// Shows DAT-SEALED (Exhaustive), bound: any 8 seals, any of the first 5 needed.
#[cfg_attr(kani, kani::proof)]
fn seals_are_all_needed() {
    // The seals that the kernel has, and two more that it may get.
    let has: u8 = kani::any();
    let needed = kani::any_where(|needed: &u8| *needed < 32);
    let contains = Seals(u32::from(has)).contains(Seals(u32::from(needed)));
    let mut missing = 0;
    let mut bit = 1;
    while bit < 32 {
        missing += u8::from(needed & bit != 0 && has & bit == 0);
        bit *= 2;
    }
    assert_eq!(contains, missing == 0);
    kani::cover!(
        contains && u32::from(needed) == Seals::POOLED.0,
        "a pooled file"
    );
    kani::cover!(missing == 1 && needed.count_ones() == 4, "one is missing");
}

/// No count of messages, time or delay in a stranger's file makes a reader overflow or panic.
//= SM2-CNT-005, SM2-CNT-006 kani
// Shows CNT-READ (BoundariesAndSamples), bound: any count of messages and delays, one recent value.
#[cfg_attr(kani, kani::proof)]
// 32 recent messages.
#[cfg_attr(kani, kani::unwind(34))]
fn a_strangers_counters_can_be_read() {
    let mut entry = Entry {
        messages: kani::any(),
        delay_sum_ns: kani::any(),
        ..Entry::default()
    };
    let noted = entry.messages.min(RECENT as u64) as usize;
    // The last message stands where its number says.
    let (last, value) = (recent_index(entry.messages), kani::any());
    entry.recent_ns[last] = value;
    assert_eq!(entry.recent().len(), noted);
    assert_eq!(entry.recent().last(), (noted > 0).then_some(value));
    assert_eq!(entry.gaps().is_some(), noted > 1);
    assert_eq!(
        entry.recent_delays().map(|it| it.max_ns),
        (noted > 0).then_some(value)
    );
    assert_eq!(entry.mean_delay_ns().is_some(), entry.messages > 0);
    kani::cover!(
        entry.messages == u64::MAX,
        "as many messages as there are numbers"
    );
    kani::cover!(noted == 1, "one message");
}

/// Mean and deviation of any three durations are in their range.
//= SM2-CNT-005 kani
// Shows CNT-READ (BoundariesAndSamples), bound: any 3 durations.
#[cfg_attr(kani, kani::proof)]
// Three durations; the root of 128 bits takes 64 steps.
#[cfg_attr(kani, kani::unwind(66))]
fn summaries_are_in_range() {
    let durations: [u64; 3] = kani::any();
    let Some(summary) = Summary::of(durations.into_iter()) else {
        panic!("there are three");
    };
    let sum: u128 = durations.iter().map(|it| u128::from(*it)).sum();
    assert_eq!(u128::from(summary.mean_ns), sum / 3);
    assert!(durations.contains(&summary.min_ns) && durations.contains(&summary.max_ns));
    assert!((summary.min_ns..=summary.max_ns).contains(&summary.mean_ns));
    assert!(summary.std_dev_ns <= summary.max_ns - summary.min_ns);
    assert!(Summary::of([0; 0].into_iter()).is_none());
    kani::cover!(summary.std_dev_ns > u64::from(u32::MAX), "far apart");
    kani::cover!(
        summary.max_ns == u64::MAX && summary.min_ns > 0,
        "the longest there is"
    );
}

#[cfg(test)]
kani::explored! {
    matching_is_symmetric: 2,
    deadlines_decide_a_match: 2,
    leases_decide_a_match: 2,
    legal_contracts_have_legal_windows: 2,
    counter_files_are_whole: 2,
    recent_messages_follow_each_other: 1,
    counter_entries_are_canonical: 2,
    codes_have_one_meaning: 2,
    truncated_datagrams_are_refused: 2,
    descriptors_are_counted: 3,
    deadlines_saturate: 2,
    seals_are_all_needed: 2,
    a_strangers_counters_can_be_read: 2,
    summaries_are_in_range: 2,
}
