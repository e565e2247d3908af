//! The order in which a router updates all sources, piece by piece.

use alloc::collections::BTreeMap;
use core::ops::Bound;

use super::{super::Subject, input::Source, source::SourceState};

/// The sources of each topic and service.
pub(super) type Sources = BTreeMap<Subject, BTreeMap<Source, SourceState>>;

/// A source of a topic or service.
pub(super) type Key = (Subject, Source);

/// A walk over all sources, in their order. A walk that starts over while it is unfinished goes on where it is, and
/// ends there after one round: however often peers connect, each source is updated once in every round.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Walk {
    /// The source that was updated last.
    after: Option<Key>,
    /// The source that is updated last of all; `None` stands for the greatest one.
    last: Option<Key>,
    /// True if the walk reaches the greatest source before it comes to `last`.
    wraps: bool,
}

impl Walk {
    /// Visits each source once from now on.
    pub(super) fn start_over(&mut self) {
        self.last.clone_from(&self.after);
        self.wraps = self.after.is_some();
    }

    /// The next source; `None` if the walk is over.
    pub(super) fn next(&mut self, sources: &Sources) -> Option<Key> {
        loop {
            match next_after(sources, self.after.as_ref()) {
                Some(key) => {
                    let is_over = |last: &Key| !self.wraps && key > *last;
                    if self.last.as_ref().is_some_and(is_over) {
                        return None;
                    }
                    self.after = Some(key.clone());
                    return Some(key);
                }
                None if self.wraps => (self.wraps, self.after) = (false, None),
                None => return None,
            }
        }
    }
}

fn next_after(sources: &Sources, after: Option<&Key>) -> Option<Key> {
    let Some((subject, source)) = after else {
        return first_of(sources.first_key_value());
    };
    let rest = (Bound::Excluded(source), Bound::Unbounded);
    let of_subject = sources.get(subject);
    if let Some((source, _)) = of_subject.and_then(|it| it.range(rest).next()) {
        return Some((subject.clone(), *source));
    }
    let rest = (Bound::Excluded(subject), Bound::Unbounded);
    first_of(sources.range::<Subject, _>(rest).next())
}

/// The first source of a subject. Each subject has one.
fn first_of(subject: Option<(&Subject, &BTreeMap<Source, SourceState>)>) -> Option<Key> {
    let (subject, sources) = subject?;
    let (source, _) = sources.first_key_value()?;
    Some((subject.clone(), *source))
}
