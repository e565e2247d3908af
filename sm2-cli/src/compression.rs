//! The compression of a bag, as an argument.

use clap::ValueEnum;

/// [`sm2_bag::Compression`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Compression {
    // These are not doc comments: clap would add them to the help.
    None,
    Lz4,
    Zstd,
}

impl From<Compression> for sm2_bag::Compression {
    fn from(compression: Compression) -> Self {
        match compression {
            Compression::None => Self::None,
            Compression::Lz4 => Self::Lz4,
            Compression::Zstd => Self::Zstd,
        }
    }
}
