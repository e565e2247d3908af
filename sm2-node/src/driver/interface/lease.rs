use sm2_proto::{Contract, LeaseWatch};

/// The lease of an interface.
#[derive(Debug, Default)]
pub(super) struct Lease {
    /// The lease that a publisher offers.
    pub(super) watch: Option<LeaseWatch>,
    /// How often publishers stopped being alive, on links that are gone.
    pub(super) lost_on_ended_links: u64,
}

impl Lease {
    /// The lease of an interface that is declared now.
    pub(super) fn of(contract: &Contract) -> Self {
        let watch = match contract {
            Contract::Publisher { offer, .. } => LeaseWatch::new(offer.lease, sm2_io::clock::now()),
            Contract::Subscriber { .. } | Contract::Server { .. } | Contract::Client { .. } => None,
        };
        Self {
            watch,
            ..Self::default()
        }
    }
}
