//! The pool against a model that remembers every slot.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;

/// Memory that knows which slot it is, so that a mix-up shows.
type Mark = (u32, u32);

fn marks(geometry: Geometry) -> impl Iterator<Item = Mark> {
    (0..geometry.slots).map(move |slot| (geometry.id, slot))
}

fn taken(pool: &mut Pool<Mark>, len: u64) -> Result<Lease<Mark>, Full> {
    if let Some(lease) = pool.take(len) {
        return Ok(lease);
    }
    let geometry = pool.plan(len)?;
    pool.add(geometry, marks(geometry));
    Ok(pool.take(len).expect("a slot that was just added"))
}

#[test]
fn sizes_are_powers_of_two_from_a_page_on() {
    let sizes = [
        (0, 4096),
        (1, 4096),
        (4096, 4096),
        (4097, 8192),
        (10_000_000, 1 << 24),
        (1 << 40, 1 << 40),
    ];
    for (len, stride) in sizes {
        assert_eq!(stride_for(len), stride, "{len}");
    }
}

#[test]
fn the_slot_given_back_last_is_taken_first() {
    let mut pool = Pool::new(u64::MAX);
    let leases: Vec<_> = (0..3).map(|_| taken(&mut pool, 5000).unwrap()).collect();
    assert_eq!(
        leases.iter().map(|it| it.slot).collect::<Vec<_>>(),
        [0, 1, 2]
    );
    for lease in leases {
        assert_eq!(pool.give_back(lease), None);
    }
    assert_eq!(pool.take(8192).unwrap().slot, 2);
    assert_eq!(pool.take(8192).unwrap().slot, 1);
}

#[test]
fn a_class_doubles() {
    let mut pool = Pool::new(u64::MAX);
    let leases: Vec<_> = (0..20)
        .map(|_| taken(&mut pool, 2 << 20).unwrap())
        .collect();
    let sizes: Vec<_> = (pool.segments.values())
        .map(|segment| segment.geometry.slots)
        .collect();
    assert_eq!(sizes, [1, 1, 2, 4, 8, 16]);
    assert_eq!(leases.len(), 20);
}

#[test]
fn the_limit_holds_and_idle_segments_make_room() {
    let mut pool = Pool::new(96 << 10);
    let small = taken(&mut pool, 1).unwrap();
    assert_eq!(pool.bytes(), 64 << 10);
    assert_eq!(pool.plan(40_000), Err(Full));
    assert!(pool.idle().is_empty(), "one slot is in use");
    let first = pool.give_back(small);
    assert_eq!(first, None);
    assert_eq!(pool.idle(), [0]);
    let large = taken(&mut pool, 40_000).unwrap();
    assert_eq!((large.segment.stride, large.segment.slots), (64 << 10, 1));
    assert_eq!(pool.plan(2_u64.pow(40) + 1), Err(Full));
}

#[test]
fn an_abandoned_slot_ends_its_segment_when_the_others_are_back() {
    let mut pool = Pool::new(u64::MAX);
    let [first, second, third] = [(); 3].map(|()| taken(&mut pool, 1).unwrap());
    assert_eq!(pool.give_back(first), None);
    assert_eq!(pool.abandon(second), None, "the third is still in use");
    let other = taken(&mut pool, 1).unwrap();
    assert_ne!(
        other.segment.id, third.segment.id,
        "no slot of a segment that ends"
    );
    assert_eq!(pool.give_back(third), Some(0));
    assert_eq!(pool.segments.len(), 1);
    let lonely = taken(&mut pool, 2 << 20).unwrap();
    let id = lonely.segment.id;
    assert_eq!(pool.abandon(lonely), Some(id));
}

#[derive(Clone, Debug)]
enum Step {
    Take { len: u64 },
    GiveBack { which: prop::sample::Index },
    Abandon { which: prop::sample::Index },
    Idle,
}

fn step() -> impl Strategy<Value = Step> {
    let which = any::<prop::sample::Index>;
    prop_oneof![
        8 => prop::sample::select(vec![0, 1, 4096, 4097, 70_000, 1 << 20, (1 << 20) + 1])
            .prop_map(|len| Step::Take { len }),
        6 => which().prop_map(|which| Step::GiveBack { which }),
        1 => which().prop_map(|which| Step::Abandon { which }),
        1 => Just(Step::Idle),
    ]
}

/// What a pool must have done, slot by slot.
#[derive(Default)]
struct Model {
    /// Slots per segment that are in use, free, and gone.
    segments: BTreeMap<u32, (Geometry, u32)>,
    retired: Vec<u32>,
    used: Vec<Lease<Mark>>,
}

impl Model {
    /// A lease was returned. The segment that is over by this, if it is.
    fn back(&mut self, id: u32) -> Option<u32> {
        let (_, used) = self.segments.get_mut(&id).expect("a live segment");
        *used -= 1;
        (*used == 0 && self.retired.contains(&id)).then(|| {
            self.segments.remove(&id);
            self.retired.retain(|&it| it != id);
            id
        })
    }
}

proptest! {
    #[test]
    fn no_slot_is_used_twice_and_none_is_lost(steps in prop::collection::vec(step(), 1..200)) {
        const LIMIT: u64 = 24 << 20;
        let mut pool = Pool::new(LIMIT);
        let mut model = Model::default();
        for step in steps {
            match step {
                Step::Take { len } => {
                    let Ok(lease) = taken(&mut pool, len) else {
                        prop_assert!(pool.bytes() + stride_for(len) > LIMIT);
                        continue;
                    };
                    let id = lease.segment.id;
                    prop_assert_eq!(lease.memory, (id, lease.slot));
                    prop_assert!(lease.slot < lease.segment.slots);
                    prop_assert!(len <= lease.segment.stride);
                    prop_assert!(!model.retired.contains(&id));
                    let twice = |it: &Lease<Mark>| it.memory == lease.memory;
                    prop_assert!(!model.used.iter().any(twice));
                    model.segments.entry(id).or_insert((lease.segment, 0)).1 += 1;
                    prop_assert_eq!(model.segments[&id].0, lease.segment);
                    model.used.push(lease);
                }
                Step::GiveBack { which } if !model.used.is_empty() => {
                    let lease = model.used.swap_remove(which.index(model.used.len()));
                    let expected = model.back(lease.segment.id);
                    prop_assert_eq!(pool.give_back(lease), expected);
                }
                Step::Abandon { which } if !model.used.is_empty() => {
                    let lease = model.used.swap_remove(which.index(model.used.len()));
                    let id = lease.segment.id;
                    if !model.retired.contains(&id) {
                        model.retired.push(id);
                    }
                    let expected = model.back(id);
                    prop_assert_eq!(pool.abandon(lease), expected);
                }
                Step::Idle => {
                    let idle = pool.idle();
                    for id in &idle {
                        prop_assert!(model.segments.get(id).is_none_or(|(_, used)| *used == 0));
                        model.segments.remove(id);
                    }
                }
                Step::GiveBack { .. } | Step::Abandon { .. } => {}
            }
            let live: u64 = model.segments.values().map(|(geometry, _)| geometry.bytes()).sum();
            prop_assert_eq!(pool.bytes(), live);
        }
    }
}
