//! InterfaceTroubles of interfaces, as the counters of their nodes tell.

use std::fmt;

use serde::Serialize;
use sm2_proto::{EntityId, text::Counted};

use crate::{sampling::Sample, view::View};

/// A trouble of one interface.
#[derive(Serialize)]
#[serde(untagged)]
pub(crate) enum InterfaceTrouble {
    /// A publisher published messages while no subscriber was linked.
    Unheard { publisher: String, messages: u64 },
    /// A publisher published nothing in some periods of its deadline, or a subscriber got nothing.
    MissedDeadlines { interface: String, periods: u64 },
    /// A publisher stopped being alive, or a subscriber had such publishers.
    LostLiveliness { interface: String, times: u64 },
}

/// The troubles of some interfaces.
#[derive(Serialize)]
pub(crate) struct InterfaceTroubles {
    unheard: Vec<InterfaceTrouble>,
    missed_deadlines: Vec<InterfaceTrouble>,
    lost_liveliness: Vec<InterfaceTrouble>,
}

impl InterfaceTrouble {
    /// The publishers among these interfaces that have published to nobody.
    pub(crate) fn unheard(view: &View<'_>, sample: &Sample, of: &[EntityId]) -> Vec<Self> {
        let found = sample.counted(view, of, |entry| entry.unheard);
        let found = found.map(|(publisher, messages)| Self::Unheard {
            publisher,
            messages,
        });
        found.collect()
    }
}

impl InterfaceTroubles {
    pub(crate) fn find(view: &View<'_>, sample: &Sample, of: &[EntityId]) -> Self {
        let missed = sample.counted(view, of, |entry| entry.missed_deadlines);
        let missed = missed
            .map(|(interface, periods)| InterfaceTrouble::MissedDeadlines { interface, periods });
        let lost = sample.counted(view, of, |entry| entry.lost_liveliness);
        let lost =
            lost.map(|(interface, times)| InterfaceTrouble::LostLiveliness { interface, times });
        Self {
            unheard: InterfaceTrouble::unheard(view, sample, of),
            missed_deadlines: missed.collect(),
            lost_liveliness: lost.collect(),
        }
    }

    /// The troubles as text.
    pub(crate) fn lines(&self) -> impl Iterator<Item = String> {
        let all = [&self.unheard, &self.missed_deadlines, &self.lost_liveliness];
        all.into_iter().flatten().map(InterfaceTrouble::to_string)
    }
}

impl fmt::Display for InterfaceTrouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unheard {
                publisher,
                messages,
            } => {
                let messages = Counted::new(*messages, "message");
                write!(
                    f,
                    "{publisher} published {messages} while no subscriber was linked"
                )
            }
            Self::MissedDeadlines { interface, periods } => {
                let periods = Counted::new(*periods, "period");
                write!(f, "{interface} missed its deadline in {periods}")
            }
            Self::LostLiveliness { interface, times } => {
                let times = Counted::new(*times, "time");
                write!(f, "{interface} lost liveliness {times}")
            }
        }
    }
}
