use proptest::prelude::*;

use super::*;

const MIB: usize = 1024 * 1024;

/// A frame of this length. Its first bytes are a number.
fn frame(number: u32, len: usize) -> Frame {
    let mut frame = vec![0; len.max(4)];
    frame[..4].copy_from_slice(&number.to_le_bytes());
    frame
}

fn number(frame: &Frame) -> u32 {
    u32::from_le_bytes(frame[..4].try_into().unwrap())
}

/// Takes and writes the next frame.
fn take(outbox: &mut Outbox) -> Option<u32> {
    let frame = outbox.pop()?;
    outbox.written();
    Some(number(&frame))
}

#[test]
fn messages_of_a_topic_keep_their_order() {
    let mut outbox = Outbox::new(MIB);
    for at in 0..100 {
        assert_eq!(outbox.push(7, frame(at, 100)), Room::Free);
    }
    for at in 0..100 {
        assert_eq!(take(&mut outbox), Some(at));
    }
    assert_eq!(take(&mut outbox), None);
    assert_eq!((outbox.bytes(), outbox.displaced()), (0, 0));
}

#[test]
fn a_large_topic_keeps_only_its_newest_message() {
    let mut outbox = Outbox::new(64 * MIB);
    for at in 0..10 {
        assert_eq!(outbox.push(1, frame(at, MIB)), Room::Free);
    }
    assert_eq!(outbox.displaced(), 9);
    assert_eq!(take(&mut outbox), Some(9));
    assert_eq!(take(&mut outbox), None);
}

#[test]
fn a_rare_topic_does_not_wait_behind_a_large_one() {
    let mut outbox = Outbox::new(64 * MIB);
    outbox.push(1, frame(100, 10 * MIB));
    for at in 0..3 {
        outbox.push(2, frame(at, 50));
    }
    assert_eq!(
        [(); 4].map(|()| take(&mut outbox)),
        [0, 1, 2, 100].map(Some)
    );
}

#[test]
fn topics_share_the_link_by_bytes() {
    let mut outbox = Outbox::new(64 * MIB);
    // Both have a backlog. For each message of topic 1, topic 2 sends about ten.
    for at in 0..20 {
        outbox.push(1, frame(1_000 + at, 10_000));
    }
    for at in 0..200 {
        outbox.push(2, frame(at, 1_000));
    }
    let first: Vec<_> = (0..55).filter_map(|_| take(&mut outbox)).collect();
    let large = first.iter().filter(|it| **it >= 1_000).count();
    assert!((4..=6).contains(&large), "{large} of 55");
}

#[test]
fn a_topic_that_was_silent_gets_no_credit() {
    let mut outbox = Outbox::new(64 * MIB);
    for at in 0..50 {
        outbox.push(1, frame(at, 1_000));
        assert_eq!(take(&mut outbox), Some(at));
    }
    // Topic 2 begins now. It shares with topic 1, although topic 1 has sent much before.
    for at in 0..10 {
        outbox.push(1, frame(100 + at, 1_000));
        outbox.push(2, frame(200 + at, 1_000));
    }
    let first: Vec<_> = (0..10).filter_map(|_| take(&mut outbox)).collect();
    let second = first.iter().filter(|it| **it >= 200).count();
    assert!((4..=6).contains(&second), "{first:?}");
}

#[test]
fn a_topic_whose_messages_are_displaced_is_served() {
    let mut outbox = Outbox::new(64 * MIB);
    let mut served = 0;
    // Topic 2 fills the link alone. Each message of topic 1 displaces the one before, unless that was taken.
    for at in 0..2_000 {
        outbox.push(1, frame(10_000 + at, 200_000));
        outbox.push(2, frame(at, 1_000));
        outbox.push(2, frame(at, 1_000));
        served += usize::from(take(&mut outbox) >= Some(10_000));
    }
    // A fair share is that of one message of topic 1 for 200 of topic 2.
    assert!((8..=12).contains(&served), "{served}");
}

#[test]
fn the_largest_topic_makes_room() {
    let mut outbox = Outbox::new(300_000);
    for at in 0..100 {
        outbox.push(1, frame(at, 2_000));
    }
    // Topic 2 fills the budget. It loses its own messages and those of no smaller topic.
    for at in 0..2_000 {
        outbox.push(2, frame(1_000 + at, 1_000));
    }
    assert!(outbox.bytes() <= 300_000);
    outbox.push(3, frame(9_000, 10));
    let taken: Vec<_> = std::iter::from_fn(|| take(&mut outbox)).collect();
    assert!(taken.contains(&9_000));
    assert!(taken.contains(&99), "the newest of topic 1");
    assert!(taken.contains(&2_999), "the newest of topic 2");
}

#[test]
fn a_message_longer_than_the_budget_is_refused() {
    let mut outbox = Outbox::new(1_000);
    assert_eq!(outbox.push(1, frame(0, 1_000)), Room::TooLong);
    assert_eq!(outbox.push(1, frame(0, 900)), Room::Free);
    assert_eq!(outbox.pop().map(|it| number(&it)), Some(0));
    // That in flight counts, too.
    assert_eq!(outbox.push(1, frame(1, 500)), Room::Full);
    outbox.written();
    assert_eq!(outbox.push(1, frame(2, 500)), Room::Free);
}

#[test]
fn control_frames_go_first_and_have_a_limit() {
    let mut outbox = Outbox::new(MIB);
    outbox.push(1, frame(1, 10));
    outbox.control(frame(2, 10)).unwrap();
    assert_eq!([take(&mut outbox), take(&mut outbox)], [Some(2), Some(1)]);
    for at in 0..15 {
        assert_eq!(outbox.control(frame(at, MIB)), Ok(()));
    }
    assert_eq!(outbox.control(frame(15, MIB)), Err(Unread));
}

#[test]
fn messages_of_an_ended_subscription_are_forgotten() {
    let mut outbox = Outbox::new(MIB);
    outbox.push(1, frame(1, 10));
    outbox.push(2, frame(2, 10));
    outbox.remove(1);
    assert_eq!(take(&mut outbox), Some(2));
    assert_eq!((take(&mut outbox), outbox.bytes()), (None, 0));
}

#[derive(Clone, Debug)]
enum Step {
    Push(SubscriptionId, usize),
    Take,
    Remove(SubscriptionId),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        5 => (0..4_u32, 0..150_000_usize).prop_map(|(id, len)| Step::Push(id, len)),
        3 => Just(Step::Take),
        1 => (0..4_u32).prop_map(Step::Remove),
    ]
}

proptest! {
    /// In every history the budget holds, each topic keeps its order, and a message that was pushed is its newest.
    #[test]
    fn the_budget_holds(budget in 200_000..700_000_usize, steps in prop::collection::vec(step(), 0..200)) {
        let mut outbox = Outbox::new(budget);
        let mut newest = BTreeMap::new();
        let mut last = BTreeMap::new();
        let mut in_flight = false;
        for (at, step) in (1..).zip(steps) {
            match step {
                Step::Push(id, len) => {
                    let message = frame(at * 4 + id, len);
                    let fits = outbox.in_flight_bytes + cost(&message) <= budget;
                    match outbox.push(id, message) {
                        Room::Free => drop(newest.insert(id, at * 4 + id)),
                        // Only a message that is the largest of all is refused.
                        Room::Full => {
                            let largest = outbox.topics.values().map(|it| it.bytes).max();
                            prop_assert!(!fits || largest.unwrap_or(0) <= len.max(4) + OVERHEAD_BYTES);
                            newest.remove(&id);
                        }
                        Room::TooLong => prop_assert!(false, "shorter than the budget"),
                    }
                }
                Step::Take => {
                    if in_flight {
                        outbox.written();
                    }
                    in_flight = false;
                    if let Some(frame) = outbox.pop() {
                        in_flight = true;
                        let (taken, id) = (number(&frame), number(&frame) % 4);
                        prop_assert!(last.insert(id, taken).is_none_or(|before| before < taken));
                    }
                }
                Step::Remove(id) => {
                    outbox.remove(id);
                    newest.remove(&id);
                }
            }
            prop_assert!(outbox.bytes() <= budget);
            let sum: usize = outbox.topics.values().map(|it| it.bytes).sum();
            prop_assert_eq!(sum, outbox.waiting_bytes);
            for (id, topic) in &outbox.topics {
                let frames: usize = topic.messages.iter().map(cost).sum();
                prop_assert_eq!(frames, topic.bytes);
                prop_assert!(topic.bytes <= TOPIC_BYTES || topic.messages.len() == 1);
                if let (Some(back), Some(newest)) = (topic.messages.back(), newest.get(id)) {
                    prop_assert_eq!(number(back), *newest);
                }
            }
        }
    }
}
