/// The verdict on an engine.
#[derive(Debug)]
pub(crate) enum Verdict {
    Held,
    Failed { why: String },
    Skipped { why: String },
}

impl Verdict {
    pub(crate) fn fail(&mut self, why: String) {
        *self = Self::Failed { why };
    }

    /// Marks as skipped, unless it has failed.
    pub(crate) fn skip(&mut self, why: String) {
        if let Self::Held = self {
            *self = Self::Skipped { why };
        }
    }
}
