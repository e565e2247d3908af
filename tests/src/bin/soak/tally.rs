//! The sums of a process, and the lines that report them.

/// The sums of one process, since its start.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    pub(crate) checked: u64,
    /// Of these: messages and replies that came through the gateways.
    pub(crate) remote: u64,
    pub(crate) damaged: u64,
    pub(crate) unaccounted: u64,
    pub(crate) errors: u64,
}

impl Tally {
    /// Counts a damaged message, and reports it.
    pub(crate) fn damaged(&mut self, what: &str) {
        self.damaged += 1;
        println!("wrong damaged: {what}");
    }

    /// Counts messages without a known fate, and reports them.
    pub(crate) fn unaccounted(&mut self, messages: u64, what: &str) {
        self.unaccounted += messages;
        println!("wrong {messages} unaccounted: {what}");
    }

    /// Counts an error that must not happen, and reports it.
    pub(crate) fn error(&mut self, what: &str) {
        self.errors += 1;
        println!("wrong error: {what}");
    }

    /// Reports the sums.
    pub(crate) fn print(&self) {
        let Self {
            checked,
            remote,
            damaged,
            unaccounted,
            errors,
        } = self;
        println!("tally {checked} {remote} {damaged} {unaccounted} {errors}");
    }

    /// The tally of a line behind `tally`.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let mut numbers = text.split_whitespace().map(str::parse);
        let mut next = || numbers.next()?.ok();
        Some(Self {
            checked: next()?,
            remote: next()?,
            damaged: next()?,
            unaccounted: next()?,
            errors: next()?,
        })
    }
}
