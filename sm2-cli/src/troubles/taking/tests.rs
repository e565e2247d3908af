use sm2_proto::{
    EntityId, InterfaceId, NodeId,
    counters::recent_index,
    link::{Counters, Fate},
};

use super::*;

/// A second, in nanoseconds.
const S: u64 = 1_000_000_000;

/// The sending end of a link that began at second 1, with messages of these times.
fn sender(times_s: &[u64]) -> Entry {
    let messages = times_s.len() as u64;
    let mut entry = Entry {
        messages,
        created: Instant(S),
        fates: Counters {
            offered: messages,
            in_flight: messages,
            ..Counters::default()
        },
        ..Entry::default()
    };
    for (message, time_s) in (1..).zip(times_s) {
        entry.recent_ns[recent_index(message)] = time_s * S;
    }
    entry
}

/// The receiving end, which took that many messages, the last of them at that second.
fn receiver(messages: u64, last_s: u64) -> Entry {
    Entry {
        messages,
        last: Instant(last_s * S),
        created: Instant(S),
        ..Entry::default()
    }
}

fn ends<'e>(sent: &'e Entry, taken: &'e Entry) -> Ends<'e> {
    let entity = |interface| EntityId {
        node: NodeId(1),
        interface: InterfaceId(interface),
    };
    Ends {
        sender: entity(1),
        receiver: entity(2),
        sent: Some(sent),
        taken: Some(taken),
    }
}

/// The number of messages that wait, and since which second.
fn untaken_since(sent: &Entry, taken: &Entry) -> Option<(u64, u64)> {
    untaken(&ends(sent, taken)).map(|it| (it.messages, it.since.0 / S))
}

#[test]
fn an_end_that_has_taken_all_is_idle() {
    assert_eq!(untaken_since(&sender(&[]), &receiver(0, 0)), None);
    // The sender does not know yet that its messages were released.
    assert_eq!(untaken_since(&sender(&[2, 3]), &receiver(2, 3)), None);
}

#[test]
fn the_time_begins_with_the_first_message_that_waits() {
    // It took the message of second 2, and those of the seconds 7 and 8 wait.
    let taken = receiver(1, 2);
    assert_eq!(untaken_since(&sender(&[2, 7, 8]), &taken), Some((2, 7)));
    // Nothing was ever taken.
    assert_eq!(
        untaken_since(&sender(&[4, 5]), &receiver(0, 0)),
        Some((2, 4))
    );
    // A latched message that is older than the link.
    let mut latched = sender(&[0]);
    latched.created = Instant(9 * S);
    assert_eq!(untaken_since(&latched, &receiver(0, 0)), Some((1, 9)));
    // The message that waits came just before the last one was taken.
    assert_eq!(
        untaken_since(&sender(&[2, 3]), &receiver(1, 4)),
        Some((1, 4))
    );
}

/// The sender remembers the times of 32 messages. Earlier ones may have come as soon as the end was idle.
#[test]
fn forgotten_times_count_from_the_last_message_that_was_taken() {
    let times: Vec<u64> = (10..60).collect();
    assert_eq!(
        untaken_since(&sender(&times), &receiver(3, 12)),
        Some((47, 12))
    );
    assert_eq!(
        untaken_since(&sender(&times), &receiver(40, 49)),
        Some((10, 50))
    );
}

#[test]
fn messages_that_were_dropped_do_not_wait() {
    for fate in Fate::ALL.into_iter().filter(|it| it.is_drop()) {
        let mut sent = sender(&[2, 3, 4, 5]);
        *sent.fates.of_mut(fate) = 3;
        sent.fates.in_flight = 1;
        assert!(sent.fates.is_balanced());
        assert_eq!(waiting(&sent, &receiver(0, 0)), 1, "{fate}");
        assert_eq!(waiting(&sent, &receiver(1, 5)), 0, "{fate}");
    }
    // They have expired at the receiving end, and the sender does not know it yet.
    let mut taken = receiver(1, 5);
    taken.fates.expired = 3;
    assert_eq!(waiting(&sender(&[2, 3, 4, 5]), &taken), 0);
    // They are still at the sender.
    let mut short = sender(&[2, 3]);
    short.short_since = Some(Instant(2 * S));
    assert_eq!(untaken_since(&short, &receiver(0, 0)), None);
    // Requests that were cancelled, and are settled.
    let mut sent = sender(&[2, 3]);
    (sent.fates.delivered, sent.fates.in_flight) = (2, 0);
    assert_eq!(waiting(&sent, &receiver(0, 0)), 0);
}

/// An entry of another node may say anything.
#[test]
fn no_counters_make_it_panic() {
    for value in [0, 1, u64::MAX] {
        let mut fates = Counters {
            offered: value,
            in_flight: value,
            ..Counters::default()
        };
        for fate in Fate::ALL {
            *fates.of_mut(fate) = value;
        }
        let entry = Entry {
            messages: value,
            last: Instant(value),
            held: value,
            fates,
            recent_ns: [value; 32],
            ..Entry::default()
        };
        let of_nothing = Entry::default();
        for (sent, taken) in [
            (&entry, &entry),
            (&entry, &of_nothing),
            (&of_nothing, &entry),
        ] {
            let ends = ends(sent, taken);
            for now in [Instant(0), Instant(u64::MAX)] {
                let found = NotTaking::find(&ends, now, "a", "b");
                let holding = Holding::find(&ends, now, "a", "b");
                let texts = [
                    found.map(|it| it.to_string()),
                    holding.map(|it| it.to_string()),
                ];
                assert!(texts.iter().flatten().all(|text| !text.is_empty()));
            }
        }
    }
}

/// Each limit: one nanosecond less, and there is no report.
#[test]
fn an_end_is_reported_after_two_seconds() {
    let (sent, taken) = (sender(&[2, 7, 8]), receiver(1, 2));
    let find = |now| {
        NotTaking::find(
            &ends(&sent, &taken),
            Instant(now),
            "talker:scan",
            "ear:scan",
        )
    };
    assert!(find(9 * S - 1).is_none());
    let found = find(9 * S).expect("two seconds have passed");
    assert_eq!(
        found.to_string(),
        "ear:scan has taken nothing for 2 s, while 2 messages of talker:scan wait"
    );
    assert!(found.remedy().contains("debugger"));

    let holder = Entry {
        held: 1,
        max_held: 1,
        ..receiver(1, 2)
    };
    let found = NotTaking::find(&ends(&sent, &holder), Instant(10 * S), "a:x", "b:x");
    let found = found.expect("it takes nothing");
    assert!(
        found
            .to_string()
            .ends_with("; it holds 1 sample, which is all that it can hold"),
        "{found}"
    );
    assert!(found.remedy().contains("max_borrowed"));

    let idle = sender(&[2]);
    let hold = |now| Holding::find(&ends(&idle, &holder), Instant(now), "a:x", "b:x");
    assert!(hold(4 * S - 1).is_none());
    assert_eq!(
        hold(4 * S).expect("two seconds have passed").to_string(),
        "b:x has held 1 sample of a:x for 2 s, which is all that it can hold"
    );
    let other = Entry {
        max_held: 2,
        ..holder
    };
    assert!(Holding::find(&ends(&idle, &other), Instant(9 * S), "a", "b").is_none());
}
