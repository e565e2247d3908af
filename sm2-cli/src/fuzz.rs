//! The bodies of fuzz targets in `fuzz/`, each about what this program reads of others: a
//! person's words, a stranger's messages, a node's counters.

mod command_line;
mod counters_page;
mod messages;

/// The words of a command line, and the environment that they meet.
pub fn command_line(data: &[u8]) {
    command_line::words(data);
}

/// The file of a hostile node's counters, and the figures that are made of it.
pub fn counters_page(data: &[u8]) {
    counters_page::file(data);
}

/// Two lines of schema texts, and then a message of the first type, or JSON for one.
pub fn schema_text(data: &[u8]) {
    sm2_proto::fuzz::schema_text(messages::schemas(data));
    messages::message(data);
}
