//! A mirror that follows its Manager.

// Shows MGR-MIRROR (proptest).

use crate::support::{
    cases,
    items::{LIDAR, PLANNER, items, node},
};
use proptest::{collection::vec, option, prelude::*};
use sm2_proto::{
    control::{Change, Item},
    domain::{Ask, BrokenAnswer, Domain, Mirror},
};

//= SM2-WCH-003 test
#[test]
fn a_mirror_reads_pages_and_then_changes() {
    let lidar = node(LIDAR, "lidar", 1_000, false);
    let planner = node(PLANNER, "planner", 1_000, false);
    let (first, second) = (lidar.key(), planner.key());
    let set = |item: &Item| Change::Set { item: item.clone() };
    let mut mirror = Mirror::new();
    assert_eq!(mirror.ask(), Some(Ask::Page { after: None }));
    assert_eq!(
        mirror.changes(2, None, false),
        Err(BrokenAnswer::Unrequested)
    );
    assert_eq!(mirror.page(7, vec![lidar.clone()], Some(first)), Ok(vec![]));
    assert_eq!(mirror.ask(), Some(Ask::Page { after: Some(first) }));
    // The domain has changed since.
    assert_eq!(mirror.page(9, vec![planner.clone()], None), Ok(vec![]));
    assert_eq!(mirror.ask(), Some(Ask::Changes { after: 7 }));
    assert_eq!(mirror.page(9, vec![], None), Err(BrokenAnswer::Unrequested));
    assert_eq!(
        mirror.changes(7, Some(vec![]), false),
        Err(BrokenAnswer::OldRevision)
    );
    assert_eq!(
        mirror.changes(8, Some(vec![set(&planner)]), true),
        Ok(vec![])
    );
    assert_eq!(mirror.domain(), &Domain::new(), "not exact yet");
    assert_eq!(mirror.ask(), Some(Ask::Changes { after: 8 }));
    let gone = Change::Removed { key: first };
    let changes = mirror.changes(9, Some(vec![gone.clone()]), false);
    assert_eq!(changes, Ok(vec![set(&planner)]), "lidar came and went");
    assert_eq!(mirror.ask(), None);
    assert_eq!(mirror.domain().revision(), 9);
    // An exact mirror follows changes.
    assert_eq!(mirror.page(9, vec![], None), Err(BrokenAnswer::Unrequested));
    assert_eq!(
        mirror.changes(9, Some(vec![]), false),
        Err(BrokenAnswer::OldRevision)
    );
    let changes = mirror.changes(10, Some(vec![set(&planner), set(&lidar)]), false);
    assert_eq!(changes, Ok(vec![set(&lidar)]), "only what is news");
    // A part of the changes does not make the state exact.
    let changes = mirror.changes(11, Some(vec![gone.clone()]), true);
    assert_eq!(changes, Ok(vec![]));
    assert_eq!(mirror.domain().revision(), 10);
    let changes = mirror.changes(12, Some(vec![set(&lidar)]), false);
    assert_eq!(changes, Ok(vec![]), "it came back");
    assert_eq!(mirror.domain().revision(), 12);
    // The Manager has forgotten the changes, or another Manager has started: the mirror reads
    // everything again and returns the differences.
    assert_eq!(mirror.changes(50, None, false), Ok(vec![]));
    assert_eq!(mirror.ask(), Some(Ask::Page { after: None }));
    assert_eq!(
        mirror.domain().get(&first),
        Some(&lidar),
        "what was last known"
    );
    let late = node(PLANNER, "planner", 1_000, true);
    let changes = mirror.page(1, vec![late.clone()], None);
    assert_eq!(changes, Ok(vec![gone, set(&late)]));
    assert_eq!(mirror.domain().revision(), 1);
    assert_eq!(mirror.clone().into_domain().get(&second), Some(&late));
}

//= SM2-IFC-007 test
#[test]
fn a_mirror_does_not_take_nonsense() {
    let lidar = node(LIDAR, "lidar", 1_000, false);
    let planner = node(PLANNER, "planner", 1_000, false);
    let mut mirror = Mirror::new();
    let before = mirror.clone();
    for (items, next) in [
        (vec![planner.clone(), lidar.clone()], None),
        (vec![lidar.clone(), lidar.clone()], None),
        (vec![planner.clone()], Some(lidar.key())),
    ] {
        assert_eq!(mirror.page(1, items, next), Err(BrokenAnswer::OutOfOrder));
        assert_eq!(mirror, before);
    }
    let key = planner.key();
    mirror.page(1, vec![planner], Some(key)).expect("sense");
    for (items, next) in [
        (vec![lidar.clone()], None),
        // The mirror would ask for the same page again and again.
        (vec![], Some(key)),
        (vec![], Some(lidar.key())),
    ] {
        assert_eq!(mirror.page(1, items, next), Err(BrokenAnswer::OutOfOrder));
    }
    assert_eq!(mirror.page(1, vec![], None).map(|it| it.len()), Ok(1));
}

proptest! {
    #![proptest_config(cases(1_000))]

    /// Applying the differences between two domains to the first gives the second, also in a
    /// mirror.
    //= SM2-WCH-003 test
    #[test]
    fn differences_are_exact(
        old in vec(items(), 0..20),
        new in vec(items(), 0..20),
        cut in option::of(0..40_usize),
    ) {
        let domain = |items: Vec<Item>, revision| {
            let mut domain = Domain::new();
            domain.page(items);
            domain.apply(revision, []);
            domain
        };
        let (old, new) = (domain(old, 1), domain(new, 2));
        let changes = old.difference(&new);
        let mut changed = old.clone();
        changed.apply(2, changes.clone());
        prop_assert_eq!(&changed, &new);
        prop_assert_eq!(new.difference(&new), []);
        // The second page shows the domain after the changes already.
        let mut mirror = Mirror::new();
        let before: Vec<_> = old.items().cloned().collect();
        let cut = cut.unwrap_or(before.len()).min(before.len());
        let (head, _) = before.split_at(cut);
        if let Some(last) = head.last() {
            let key = last.key();
            mirror.page(1, head.to_vec(), Some(key)).expect("sense");
            let tail = new.items().filter(|it| it.key() > key).cloned().collect();
            mirror.page(2, tail, None).expect("sense");
            mirror.changes(2, Some(changes), false).expect("sense");
            prop_assert_eq!(mirror.domain(), &new);
            // An exact mirror follows the same changes backwards.
            let back = new.difference(&old);
            let told = mirror.changes(3, Some(back.clone()), false);
            prop_assert_eq!(told, Ok(back));
            prop_assert!(mirror.domain().items().eq(old.items()));
        }
    }
}
