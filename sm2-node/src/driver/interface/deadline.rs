use sm2_proto::{Contract, DeadlineWatch, Instant};

/// The deadline of an interface.
#[derive(Debug, Default)]
pub(super) struct Deadline {
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
        let watch = match contract {
            Contract::Publisher { offer, .. } => {
                DeadlineWatch::new(offer.deadline, sm2_io::clock::now())
            }
            Contract::Subscriber { .. } | Contract::Server { .. } | Contract::Client { .. } => None,
        };
        Self {
            watch,
            ..Self::default()
        }
    }
}
