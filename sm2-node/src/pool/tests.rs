//! Compares the pool with a model that records every slot.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::sizes::{HEAD_BYTES, HUGE_PAGE, PAGE, STRIDE_MIN};
use super::*;
use sm2_proto::limits::STRIDE_UNIT;

/// A handle that identifies its slot, to detect mix-ups.
pub(super) type Mark = (u32, u32);

pub(super) fn marks(geometry: Geometry) -> impl Iterator<Item = Mark> {
    (0..geometry.slots).map(move |slot| (geometry.id, slot))
}

pub(super) fn taken(pool: &mut Pool<Mark>, len: u64) -> Result<Lease<Mark>, Full> {
    if let Some(lease) = pool.take(len, |_| ()) {
        return Ok(lease);
    }
    let geometry = pool.plan(len)?;
    pool.add(geometry, marks(geometry));
    Ok(pool.take(len, |_| ()).expect("a slot that was just added"))
}

/// Returns a pool with a reserved segment of `slots` slots for messages of `len` bytes.
pub(super) fn reserved(len: u64, slots: u32, limit_bytes: u64) -> Pool<Mark> {
    let mut pool = Pool::new(limit_bytes);
    let geometry = pool.plan_reserved(len, slots).unwrap();
    pool.add(geometry, marks(geometry));
    pool
}

const SECOND: u64 = 1_000_000_000;

#[test]
fn the_next_slot_is_announced() {
    let mut pool = reserved(64, 3, 1 << 20);
    for slot in 0..3 {
        let mut next = None;
        let lease = pool.take(64, |it| next = Some(it.1)).unwrap();
        assert_eq!((lease.slot, next), (slot, (slot < 2).then_some(slot + 1)));
    }
}

#[test]
fn sizes_of_slots() {
    const MIB: u64 = 1 << 20;
    let sizes = [
        (0, 128),
        (64, 128),
        (65, 192),
        (129, 256),
        (192, 256),
        (193, 384),
        (1_000, 1_536),
        (3_008, 3 << 10),
        (3_009, 4 << 10),
        (4032, 4 << 10),
        (4033, 8 << 10),
        (8129, 12 << 10),
        (12_288, 16 << 10),
        (16_384, 24 << 10),
        (65_536, 96 << 10),
        (1_000_000, MIB),
        (1_048_512, MIB),
        (1_048_576, 3 * MIB / 2),
        (3 * MIB / 2, 2 * MIB),
        (2 * MIB, 4 * MIB),
        (4 * MIB, 6 * MIB),
        (6 * MIB, 8 * MIB),
        (10_000_000, 12 * MIB),
        (10_485_760, 12 * MIB),
        (12 * MIB - 64, 12 * MIB),
        (12 * MIB - 63, 16 * MIB),
        (1 << 40, 3 << 39),
    ];
    for (len, stride) in sizes {
        assert_eq!(stride_for(len), stride, "{len}");
    }
}

proptest! {
    #[test]
    fn a_slot_has_room_for_message_and_head(len in prop_oneof![
        0_u64..=MESSAGE_MAX,
        (0_u32..=40, -100_i64..100).prop_map(|(bits, by)| {
            (1_u64 << bits).saturating_add_signed(by).min(MESSAGE_MAX)
        }),
    ]) {
        let stride = stride_for(len);
        prop_assert!(stride >= len + HEAD_BYTES);
        prop_assert!(stride.is_multiple_of(STRIDE_UNIT));
        prop_assert!(stride < HUGE_PAGE || stride.is_multiple_of(HUGE_PAGE));
        // The surplus is at most half of the length, or one unit.
        let surplus = stride - len - HEAD_BYTES;
        let unit = if stride < PAGE { STRIDE_MIN } else { PAGE };
        prop_assert!(surplus <= (len / 2 + HEAD_BYTES).max(unit) || stride <= 2 * HUGE_PAGE);
        prop_assert!(stride_for(len + 1) >= stride);
        prop_assert!(stride <= SEGMENT_BYTES_MAX);
    }
}

#[test]
fn there_are_few_classes() {
    let mut strides: Vec<u64> = (0..=40 * 64)
        .map(|step| stride_for(2_f64.powf(f64::from(step) / 64.0) as u64))
        .collect();
    strides.dedup();
    assert!(strides.len() <= 2 * (41 - 7), "{strides:?}");
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
    assert_eq!(pool.take(8000, |_| ()).unwrap().slot, 2);
    assert_eq!(pool.take(8000, |_| ()).unwrap().slot, 1);
}

/// Segments are short, so that the system can take each of them back quickly, until their number gets short.
#[test]
fn a_pool_with_many_segments_gets_larger_ones() {
    let mut pool = Pool::new(u64::MAX);
    let mut leases = Vec::new();
    while pool.segments.len() <= SEGMENTS_MAX / 2 {
        leases.push(taken(&mut pool, 2 << 20).unwrap());
    }
    let slots = pool.segments.iter().map(|it| it.geometry.slots);
    let slots: Vec<u32> = slots.collect();
    let (last, others) = slots.split_last().unwrap();
    assert_eq!(others.iter().max(), Some(&8));
    assert_eq!(*last, others.iter().sum::<u32>());
}

#[test]
fn a_class_doubles_and_old_segments_are_preferred() {
    let mut pool = Pool::new(u64::MAX);
    let leases: Vec<_> = (0..20)
        .map(|_| taken(&mut pool, 2 << 20).unwrap())
        .collect();
    let sizes: Vec<_> = (pool.segments.iter())
        .map(|segment| segment.geometry.slots)
        .collect();
    // Slots of 4 MiB, and segments of at most 32 MiB.
    assert_eq!(sizes, [1, 1, 2, 4, 8, 8]);
    for lease in leases {
        assert_eq!(pool.give_back(lease), None);
    }
    let again = [(); 4].map(|()| pool.take(2 << 20, |_| ()).unwrap().segment.id);
    assert_eq!(again, [0, 1, 2, 2]);
}

#[test]
fn a_larger_slot_will_do() {
    let mut pool = Pool::new(u64::MAX);
    let large = taken(&mut pool, 100_000).unwrap();
    assert_eq!(pool.give_back(large), None);
    assert_eq!(pool.take(70_000, |_| ()).unwrap().segment.id, 0);
    assert_eq!(
        pool.take(64_000, |_| ()).unwrap().segment.id,
        0,
        "twice as large"
    );
    assert!(
        pool.take(48_000, |_| ()).is_none(),
        "a slot of more than twice the size is not used"
    );
    assert!(pool.take(140_000, |_| ()).is_none(), "too long");
}

#[test]
fn the_limit_holds_and_unused_segments_make_room() {
    let mut pool = Pool::new(96 << 10);
    let small = taken(&mut pool, 4_000).unwrap();
    assert_eq!(pool.bytes(), 64 << 10);
    assert_eq!(pool.plan(40_000), Err(Full));
    assert!(pool.unused().is_empty(), "one slot is in use");
    let first = pool.give_back(small);
    assert_eq!(first, None);
    assert_eq!(pool.unused(), [0]);
    assert_eq!(pool.bytes(), 0);
    let large = taken(&mut pool, 40_000).unwrap();
    assert_eq!((large.segment.stride, large.segment.slots), (48 << 10, 2));
    assert_eq!(pool.plan(2_u64.pow(40) + 1), Err(Full));
}

#[test]
fn segments_go_when_nobody_used_them_for_a_while() {
    let mut pool = Pool::new(u64::MAX);
    pool.keep_idle(Duration::from_secs(2));
    let mut rush: Vec<_> = (0..4)
        .map(|_| taken(&mut pool, 10 << 20).unwrap())
        .collect();
    assert!(
        pool.sweep(Instant(10 * SECOND)).is_empty(),
        "all are in use"
    );
    let held = rush.pop().unwrap();
    for lease in rush {
        assert_eq!(pool.give_back(lease), None);
    }
    assert!(
        pool.sweep(Instant(12 * SECOND)).is_empty(),
        "just given back"
    );
    let steady = taken(&mut pool, 10 << 20).unwrap();
    assert_eq!(pool.give_back(steady), None);
    assert!(pool.sweep(Instant(14 * SECOND - 1)).is_empty(), "too early");
    assert_eq!(
        pool.sweep(Instant(14 * SECOND)),
        [1],
        "0 is used, 2 is held"
    );
    assert_eq!(pool.sweep(Instant(16 * SECOND)), [0]);
    assert_eq!(pool.give_back(held), None);
    assert!(
        pool.sweep(Instant(18 * SECOND)).is_empty(),
        "given back since"
    );
    assert_eq!(pool.sweep(Instant(20 * SECOND)), [2]);
    assert_eq!(pool.bytes(), 0);
    pool.keep_idle(Duration::MAX);
    let lease = taken(&mut pool, 1).unwrap();
    assert_eq!(pool.give_back(lease), None);
    for _ in 0..2 {
        assert!(pool.sweep(Instant(u64::MAX)).is_empty(), "never");
    }
}

#[test]
fn numbers_have_15_bits_and_come_again_late() {
    let mut pool = Pool::new(u64::MAX);
    let keeps_zero = taken(&mut pool, 1).unwrap();
    let mut ids = Vec::new();
    for _ in 0..IDS + 5 {
        let lease = taken(&mut pool, 2 << 20).unwrap();
        ids.push(lease.segment.id);
        assert_eq!(pool.abandon(lease), ids.last().copied());
    }
    let round: Vec<u32> = (1..IDS).collect();
    assert_eq!(ids[..round.len()], round);
    assert_eq!(ids[round.len()..], [1, 2, 3, 4, 5, 6], "0 is in use");
    assert_eq!(pool.give_back(keeps_zero), None);
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
        "no slot of a retired segment"
    );
    assert_eq!(pool.give_back(third), Some(0));
    assert_eq!(pool.segments.len(), 1);
    let lonely = taken(&mut pool, 2 << 20).unwrap();
    let id = lonely.segment.id;
    assert_eq!(pool.abandon(lonely), Some(id));
}

#[test]
fn what_is_reserved_stays_beyond_the_limit() {
    let mut pool = reserved(100_000, 3, 0);
    assert_eq!(pool.bytes(), 3 * (128 << 10));
    pool.keep_idle(Duration::ZERO);
    for moment in 1..4 {
        assert!(pool.sweep(Instant(moment)).is_empty());
    }
    assert!(pool.unused().is_empty());
    let leases = [90_000, 1, 131_008].map(|len| pool.take(len, |_| ()).unwrap());
    assert_eq!(leases.each_ref().map(|it| it.slot), [0, 1, 2]);
    assert_eq!(pool.plan(90_000), Err(Full), "no more than was reserved");
    let endless = Pool::<Mark>::new(0);
    assert_eq!(endless.plan_reserved(1 << 40, 2), Err(Full));
    assert_eq!(endless.plan_reserved(1, SLOTS_MAX + 1), Err(Full));
    assert_eq!(endless.plan_reserved(MESSAGE_MAX + 1, 1), Err(Full));
}

#[test]
fn an_abandoned_slot_of_a_reserved_segment_is_made_up_for() {
    let mut pool = reserved(100_000, 3, 0);
    let [first, second, third] = [(); 3].map(|()| pool.take(100_000, |_| ()).unwrap());
    assert_eq!(pool.abandon(first), None);
    assert_eq!(pool.abandon(second), None);
    let made_up = pool.plan(100_000).unwrap();
    assert_eq!((made_up.slots, made_up.reserved), (2, true));
    assert_eq!(made_up.stride, third.segment.stride);
    pool.add(made_up, marks(made_up));
    let [fourth, fifth] = [(); 2].map(|()| pool.take(100_000, |_| ()).unwrap());
    assert_eq!(pool.plan(100_000), Err(Full));
    assert_eq!(pool.give_back(third), None);
    let again = pool.take(100_000, |_| ()).unwrap();
    assert_eq!(again.segment.id, 0, "the remaining slots stay in use");
    assert_eq!(pool.abandon(again), Some(0), "the last of its slots");
    assert_eq!(pool.give_back(fourth), None);
    assert_eq!(pool.give_back(fifth), None);
    assert_eq!(pool.bytes(), 2 * (128 << 10));
}

#[derive(Clone, Debug)]
enum Step {
    Take { len: u64 },
    GiveBack { which: prop::sample::Index },
    Abandon { which: prop::sample::Index },
    Unused,
    Replace,
    Sweep { after: u64 },
}

fn step() -> impl Strategy<Value = Step> {
    let which = any::<prop::sample::Index>;
    prop_oneof![
        8 => prop::sample::select(vec![0, 1, 4032, 4033, 9_000, 70_000, 90_000, 1 << 20, (2 << 20) + 1])
            .prop_map(|len| Step::Take { len }),
        6 => which().prop_map(|which| Step::GiveBack { which }),
        1 => which().prop_map(|which| Step::Abandon { which }),
        1 => Just(Step::Unused),
        1 => Just(Step::Replace),
        2 => (0..4_u64).prop_map(|after| Step::Sweep { after }),
    ]
}

/// The expected state of a pool, slot by slot.
#[derive(Default)]
struct Model {
    /// For each segment: its layout, the number of slots in use, the number of lost slots, and the step of
    /// its last use.
    segments: BTreeMap<u32, (Geometry, u32, u32, u64)>,
    retired: Vec<u32>,
    used: Vec<Lease<Mark>>,
    /// Slots that must not be taken again.
    abandoned: Vec<Mark>,
    now: u64,
    step: u64,
    /// The time and the step of the last sweep.
    swept: (u64, u64),
}

/// How long an idle segment is kept.
const IDLE: u64 = 5;

impl Model {
    fn take(&mut self, lease: Lease<Mark>) {
        let id = lease.segment.id;
        let unused = (lease.segment, 0, 0, 0);
        let (geometry, used, _, last) = self.segments.entry(id).or_insert(unused);
        assert_eq!(*geometry, lease.segment);
        *used += 1;
        *last = self.step;
        self.used.push(lease);
    }

    /// Records that a lease was returned, or that its slot is lost. Returns the segment that this frees, if
    /// any.
    fn back(&mut self, lease: &Lease<Mark>, lost: bool) -> Option<u32> {
        let id = lease.segment.id;
        if lost {
            self.abandoned.push(lease.memory);
        }
        let (geometry, used, gone, last) = self.segments.get_mut(&id).expect("a live segment");
        *used -= 1;
        *last = self.step;
        *gone += u32::from(lost);
        let all_gone = geometry.reserved && *gone == geometry.slots;
        let over = all_gone || (*used == 0 && self.retired.contains(&id));
        over.then(|| {
            self.forget(id);
            id
        })
    }

    fn forget(&mut self, id: u32) {
        self.segments.remove(&id);
        self.retired.retain(|&it| it != id);
        self.abandoned.retain(|&(segment, _)| segment != id);
    }

    /// Returns the segments that a sweep must free, of those that were used at all.
    fn idle(&mut self) -> Vec<u32> {
        if self.now - self.swept.0 < IDLE {
            return Vec::new();
        }
        let (_, since) = std::mem::replace(&mut self.swept, (self.now, self.step));
        let needed = |id: u32, stride: u64| {
            // In this test numbers grow with age.
            let mut younger = self.segments.range(id..);
            younger.any(|(_, (it, _, _, last))| it.stride == stride && *last > since)
        };
        let idle = |(id, (geometry, used, ..)): (&u32, &(Geometry, u32, u32, u64))| {
            let idle = !geometry.reserved && *used == 0 && !needed(*id, geometry.stride);
            idle.then_some(*id)
        };
        self.segments.iter().filter_map(idle).collect()
    }
}

proptest! {
    #[test]
    fn no_slot_is_used_twice_and_none_is_lost(
        steps in prop::collection::vec(step(), 1..200),
        reserve in prop::option::of(1_u32..4),
    ) {
        const LIMIT: u64 = 24 << 20;
        let mut pool = match reserve {
            Some(slots) => reserved(80_000, slots, LIMIT),
            None => Pool::new(LIMIT),
        };
        pool.keep_idle(Duration::from_nanos(IDLE));
        let mut model = Model::default();
        for step in steps {
            model.step += 1;
            match step {
                Step::Take { len } => {
                    let Ok(lease) = taken(&mut pool, len) else {
                        let grown = pool.bytes() - pool.reserved_bytes;
                        prop_assert!(grown + stride_for(len) > LIMIT);
                        continue;
                    };
                    let id = lease.segment.id;
                    prop_assert_eq!(lease.memory, (id, lease.slot));
                    prop_assert!(lease.slot < lease.segment.slots);
                    prop_assert!(len + HEAD_BYTES <= lease.segment.stride);
                    let Geometry { stride, reserved, .. } = lease.segment;
                    prop_assert!(stride <= 2 * stride_for(len) || reserved);
                    prop_assert!(!model.retired.contains(&id));
                    prop_assert!(!model.abandoned.contains(&lease.memory));
                    let twice = |it: &Lease<Mark>| it.memory == lease.memory;
                    prop_assert!(!model.used.iter().any(twice));
                    model.take(lease);
                }
                Step::GiveBack { which } if !model.used.is_empty() => {
                    let lease = model.used.swap_remove(which.index(model.used.len()));
                    let expected = model.back(&lease, false);
                    prop_assert_eq!(pool.give_back(lease), expected);
                }
                Step::Abandon { which } if !model.used.is_empty() => {
                    let lease = model.used.swap_remove(which.index(model.used.len()));
                    let id = lease.segment.id;
                    if !lease.segment.reserved && !model.retired.contains(&id) {
                        model.retired.push(id);
                    }
                    let expected = model.back(&lease, true);
                    prop_assert_eq!(pool.abandon(lease), expected);
                }
                Step::Unused => {
                    for id in pool.unused() {
                        let (geometry, used, ..) = model.segments[&id];
                        prop_assert!(used == 0 && !geometry.reserved);
                        model.forget(id);
                    }
                    for (geometry, used, ..) in model.segments.values() {
                        prop_assert!(*used > 0 || geometry.reserved);
                    }
                }
                Step::Replace => {
                    let freed = pool.replace_all();
                    model.retired = model.segments.keys().copied().collect();
                    let unused = model.segments.iter();
                    let unused = unused.filter(|(_, (_, used, ..))| *used == 0);
                    let unused: Vec<_> = unused.map(|(id, _)| *id).collect();
                    for id in unused {
                        prop_assert!(freed.contains(&id));
                        model.forget(id);
                    }
                    // A segment that was reserved and never used is not in the model.
                    prop_assert!(freed.iter().all(|id| !model.segments.contains_key(id)));
                }
                Step::Sweep { after } => {
                    model.now += after;
                    let mut expected = model.idle();
                    let mut idle = pool.sweep(Instant(model.now));
                    expected.sort_unstable();
                    idle.sort_unstable();
                    prop_assert_eq!(&idle, &expected);
                    idle.into_iter().for_each(|id| model.forget(id));
                }
                Step::GiveBack { .. } | Step::Abandon { .. } => {}
            }
            let live = model.segments.values();
            let live: u64 = live.map(|(geometry, ..)| geometry.bytes()).sum();
            let untouched = pool.segments.iter().filter(|it| {
                it.geometry.reserved && !model.segments.contains_key(&it.geometry.id)
            });
            let untouched: u64 = untouched.map(|it| it.geometry.bytes()).sum();
            prop_assert_eq!(pool.bytes(), live + untouched);
        }
    }
}
