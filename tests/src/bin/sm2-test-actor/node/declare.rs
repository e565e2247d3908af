//! Declares interfaces as commands describe them: `pub KEY TOPIC depth=4 reliable_ms=100 …`.

use std::time::Duration;

use sm2_node::{Client, DeclareError, Node, Publisher, Server, Subscriber};

/// The words of a command behind its key and name: `flag` or `name=number`.
pub(super) struct Words<'a>(pub(super) &'a [&'a str]);

impl Words<'_> {
    fn flag(&self, name: &str) -> bool {
        self.0.contains(&name)
    }

    fn number(&self, name: &str) -> Option<u64> {
        let mut values = self
            .0
            .iter()
            .filter_map(|word| word.strip_prefix(name)?.strip_prefix('='));
        values.next().map(|value| value.parse().expect("a number"))
    }

    fn small(&self, name: &str, default: u16) -> u16 {
        self.number(name).map_or(default, |value| value as u16)
    }

    fn size(&self, name: &str) -> Option<usize> {
        self.number(name).map(|value| value as usize)
    }
}

pub(super) fn publisher(
    node: &Node,
    topic: &str,
    words: &Words<'_>,
) -> Result<Publisher<[u8]>, DeclareError> {
    let mut builder = node
        .publisher_builder::<[u8]>(topic)
        .depth(words.small("depth", 8))
        .latched(words.small("latched", 0))
        .sealed(words.flag("sealed"));
    if let Some(timeout_ms) = words.number("reliable_ms") {
        builder = builder
            .reliable(true)
            .publish_timeout(Duration::from_millis(timeout_ms));
    }
    if let Some(bytes) = words.size("inline_max") {
        builder = builder.inline_max(bytes);
    }
    builder.declare()
}

pub(super) fn subscriber(
    node: &Node,
    topic: &str,
    words: &Words<'_>,
) -> Result<Subscriber<[u8]>, DeclareError> {
    let mut builder = node
        .subscriber_builder::<[u8]>(topic)
        .depth(words.small("depth", 8))
        .max_borrowed(words.small("borrow", 4))
        .reliable(words.flag("reliable"))
        .sealed(words.flag("sealed"));
    if let Some(bytes) = words.number("max_len") {
        builder = builder.max_len(bytes);
    }
    if words.flag("deadline") {
        builder = builder.deadline(Duration::from_secs(1));
    }
    if words.flag("liveliness") {
        builder = builder.liveliness(Duration::from_secs(1));
    }
    builder.declare()
}

pub(super) fn server(
    node: &Node,
    service: &str,
    words: &Words<'_>,
) -> Result<Server<[u8], [u8]>, DeclareError> {
    let mut builder = node
        .server_builder::<[u8], [u8]>(service)
        .depth(words.small("depth", 64))
        .max_borrowed(words.small("borrow", 16))
        .sealed(words.flag("sealed"));
    if let Some(bytes) = words.size("inline_max") {
        builder = builder.inline_max(bytes);
    }
    builder.declare()
}

pub(super) fn client(
    node: &Node,
    service: &str,
    words: &Words<'_>,
) -> Result<Client<[u8], [u8]>, DeclareError> {
    let mut builder = node
        .client_builder::<[u8], [u8]>(service)
        .max_borrowed(words.small("borrow", 64))
        .sealed(words.flag("sealed"));
    if let Some(bytes) = words.size("inline_max") {
        builder = builder.inline_max(bytes);
    }
    builder.declare()
}
