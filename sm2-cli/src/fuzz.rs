//! The bodies of the fuzz targets in `fuzz/`, one for each kind of input: command lines, messages, and
//! counter files.

mod command_line;
mod counters_page;
mod messages;

use sm2_node::explain::difference;

/// Fuzzes the words of a command line and the environment.
pub fn command_line(data: &[u8]) {
    command_line::words(data);
}

/// Fuzzes the counter file of a hostile node, and the figures that `sm2 top` computes from the file.
pub fn counters_page(data: &[u8]) {
    counters_page::file(data);
}

/// Fuzzes messages. The input has two lines with schema texts, and then a message of the first type or JSON
/// for one.
pub fn schema_text(data: &[u8]) {
    if let Some([one, other]) = sm2_proto::fuzz::schema_text(messages::schemas(data)) {
        let same = one == other;
        assert_eq!(difference(&one, &other).is_none(), same);
        assert_eq!(difference(&other, &one).is_none(), same);
    }
    messages::message(data);
}
