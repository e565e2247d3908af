//! Long work with bags.

use std::{fmt, fs, ops::ControlFlow};

use sm2_bag::{Bag, BagFiles, CopyError, ReadError};

use crate::{error::CliError, interrupt::Interrupt, size::Size, ticker::Ticker};

/// Shows the progress on a terminal, and ends the work when a signal comes.
pub(super) struct Work {
    interrupt: Interrupt,
    ticker: Ticker,
    progress: Progress,
}

#[derive(Clone, Copy)]
struct Progress {
    read_bytes: u64,
    /// The length of the files.
    all_bytes: u64,
}

impl Work {
    /// Begins work with these bags.
    ///
    /// # Errors
    ///
    /// [`CliError::System`] if signals cannot be caught.
    pub(super) fn begin<'a>(
        bags: impl IntoIterator<Item = &'a BagFiles>,
    ) -> Result<Self, CliError> {
        let interrupt = Interrupt::install().map_err(CliError::system("catch signals"))?;
        // A file that is not there is an error of the work.
        let files = bags.into_iter().flat_map(BagFiles::paths);
        let lengths = files.filter_map(|it| fs::metadata(it).ok());
        Ok(Self {
            interrupt,
            ticker: Ticker::new(),
            progress: Progress {
                read_bytes: 0,
                all_bytes: lengths.map(|it| it.len()).sum(),
            },
        })
    }

    /// Opens the files of a bag, and tells if one is incomplete: `doing` with what can be read.
    ///
    /// # Errors
    ///
    /// [`CliError::ReadBag`], [`CliError::Stopped`].
    pub(super) fn open(&mut self, bag: &BagFiles, doing: &str) -> Result<Vec<Bag>, CliError> {
        let bags = bag.open(&mut |it| self.advance(it));
        let bags = bags.map_err(|it| self.error(it))?;
        for bag in bags.iter().filter(|it| !it.is_complete()) {
            let path = bag.path().display();
            stderr_line!("sm2: {path} is incomplete: {doing} what can be read");
        }
        Ok(bags)
    }

    /// Counts bytes that were read.
    pub(super) fn advance(&mut self, bytes: u64) -> ControlFlow<()> {
        self.progress.read_bytes += bytes;
        let progress = self.progress;
        self.ticker.tick(|| progress);
        match self.interrupt.signal() {
            None => ControlFlow::Continue(()),
            Some(_) => ControlFlow::Break(()),
        }
    }

    /// The error of the command for an error of the work.
    pub(super) fn error(&self, error: impl Into<CliError>) -> CliError {
        match (error.into(), self.interrupt.signal()) {
            (
                CliError::ReadBag(ReadError::Stopped)
                | CliError::CopyBag(CopyError::Read(ReadError::Stopped)),
                Some(signal),
            ) => CliError::Stopped(signal),
            (error, _) => error,
        }
    }
}

impl fmt::Display for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (read, all) = (Size(self.read_bytes), Size(self.all_bytes));
        write!(f, "{read} of {all} read")
    }
}
