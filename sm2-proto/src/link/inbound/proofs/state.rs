//! Every state that the receiving side can have with a few messages.

use super::{
    super::{Delivery, Geometry, Inbound, PeerSegment, Ready, Slot},
    STRIDE,
};
use crate::{
    Instant, LinkId, Period, VERSION,
    link::{Config, MaxLen, Payload, Publications, Role, Status},
    proofs::one_of,
};

/// The state of a received message.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Stage {
    Ready,
    Borrowed,
    Consumed,
    Discarded,
    Released,
}

const STAGES: [Stage; 5] = [
    Stage::Ready,
    Stage::Borrowed,
    Stage::Consumed,
    Stage::Discarded,
    Stage::Released,
];

/// The sequence number of the first message: small, beyond 32 bits, and near the end.
const FIRST: [u64; 3] = [1, 1 << 32, u64::MAX - 2];

pub(super) struct State<const N: usize> {
    pub(super) books: Inbound,
    pub(super) stages: [Stage; N],
    pub(super) first: u64,
    pub(super) pooled: bool,
}

fn slot(at: usize, pooled: bool) -> Option<Slot> {
    pooled.then_some(Slot {
        segment: 3,
        slot: at as u32,
    })
}

impl<const N: usize> State<N> {
    /// The last messages of any link, each at any stage. A pooled message is in the slot with the
    /// index of the message.
    pub(super) fn any() -> Self {
        Self::of_link(kani::any())
    }

    /// The same for a link that is sealed, which has no segment, or not sealed.
    pub(super) fn of_link(sealed: bool) -> Self {
        let config = Config {
            id: LinkId::FIRST,
            version: VERSION,
            role: Role::Receiver,
            reliable: kani::any(),
            sealed,
            ring: false,
            depth: 1,
            max_borrowed: 1,
            max_len: MaxLen::GREATEST,
            deadline: Period::NONE,
            lifespan: Period::NONE,
            lease: Period::NONE,
            publications: Publications::UNKNOWN,
        };
        let (pooled, first): (bool, u64) = (!sealed && kani::any(), one_of(&FIRST));
        let mut books = Inbound::new(&config);
        let geometry = Geometry::new(STRIDE, 4).expect("a legal segment");
        let mut segment = PeerSegment {
            geometry,
            busy: Default::default(),
        };
        let mut stages = [Stage::Released; N];
        for (at, stage) in stages.iter_mut().enumerate() {
            *stage = one_of(&STAGES);
            let sequence = first + at as u64;
            let slot = slot(at, pooled);
            let delivery = Delivery {
                sequence,
                id: sequence,
                time: Instant(0),
                status: Status::Ok,
                lost: 0,
                len: 0,
                payload: Payload::Sealed,
            };
            let _ = match stage {
                Stage::Ready => {
                    books.ready.push_back(Ready { delivery, slot });
                    None
                }
                Stage::Borrowed => books.borrowed.insert(sequence, slot),
                Stage::Consumed => books.consumed.insert(sequence, slot),
                Stage::Discarded => books.discarded.insert(sequence, slot),
                Stage::Released => continue,
            };
            segment.busy.extend(slot.map(|it| it.slot));
        }
        if !sealed {
            books.segments.insert(3, segment);
        }
        books.sequence = first + (N as u64 - 1);
        books.last_id = Some(books.sequence);
        books.next_id = Some(first);
        let count = |wanted| stages.iter().filter(|it| **it == wanted).count();
        kani::assume(count(Stage::Ready) <= 1 || !books.displaces);
        kani::assume(count(Stage::Borrowed) <= 1);
        kani::assume(N - count(Stage::Released) <= books.window);
        let state = Self {
            books,
            stages,
            first,
            pooled,
        };
        state.books.invariants();
        state
    }

    pub(super) fn count(&self, wanted: Stage) -> usize {
        self.stages.iter().filter(|it| **it == wanted).count()
    }

    pub(super) fn unreleased(&self) -> usize {
        N - self.count(Stage::Released)
    }
}
