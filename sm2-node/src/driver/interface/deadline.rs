//! The deadline of an interface.

use sm2_proto::{Contract, DeadlineWatch, Instant, Kind, Period};

/// The deadline of an interface.
#[derive(Debug, Default)]
pub(super) struct Deadline {
    /// Whether the interface has a deadline.
    pub(super) is_there: bool,
    /// The deadline that a publisher offers.
    pub(super) watch: Option<DeadlineWatch>,
    /// How many missed periods of the publisher were reported to the program.
    pub(super) reported: u64,
    /// The time of the next tick, if the control side knows one.
    pub(super) tick_at: Option<Instant>,
    /// How many periods were missed on links that are gone.
    pub(super) missed_on_ended_links: u64,
}

impl Deadline {
    /// The deadline of an interface that is declared now.
    pub(super) fn of(contract: &Contract) -> Self {
        let deadline = contract.deadline();
        let is_there = deadline != Period::NONE;
        let promises = is_there && contract.kind() == Kind::Publisher;
        Self {
            is_there,
            watch: (promises.then(sm2_io::clock::now))
                .and_then(|now| DeadlineWatch::new(deadline, now)),
            ..Self::default()
        }
    }
}
