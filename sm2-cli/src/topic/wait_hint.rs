//! The line that explains why a command still waits for a publisher or subscriber.

use std::time::Duration;

use sm2_node::diagnostics::LinkStatus;
use sm2_node::explain::nearest;
use sm2_proto::{Kind, Name, text::Counted};

use crate::connect::CommandNode;

/// The wait after which the line is printed.
pub(super) const DELAY: Duration = Duration::from_secs(1);

/// Prints on standard error what the command waits for, and why the nodes that exist do not match. `links` are
/// the links of the command's interface on `topic`.
pub(super) fn print(
    command_node: &CommandNode,
    topic: &Name,
    wanted: Kind,
    count: usize,
    links: &[LinkStatus],
) {
    let wanted_text = wanted.to_string();
    let awaited = Counted::new(count as u64, &wanted_text);
    let reason = silent(links).or_else(|| why(command_node, topic, wanted));
    let reason = reason.map_or_else(String::new, |reason| format!("; {reason}"));
    stderr_line!("sm2: waiting for {awaited} of {topic} (Ctrl-C ends){reason}");
}

/// The text about a node that is linked and has not opened its end of the link.
fn silent(links: &[LinkStatus]) -> Option<String> {
    let link = links.iter().find(|link| !link.open && link.end.is_none())?;
    let node = &link.peer.name;
    Some(format!(
        "node {node} is linked, but does not answer: is it stopped or busy?"
    ))
}

/// The nearest counterpart, and the reason why it does not match, in one line.
fn why(command_node: &CommandNode, topic: &Name, wanted: Kind) -> Option<String> {
    // An error of the Manager is reported elsewhere.
    let domain = command_node.snapshot().ok()?;
    let own = domain.node_named(command_node.node.name().as_str())?;
    let mut interfaces = domain.interfaces_of(own.node);
    let ours = interfaces
        .find(|it| it.contract.name() == topic && it.contract.kind() == wanted.counterpart())?;
    let near = nearest(&domain, ours.entity);
    let text = near.first()?.to_string();
    Some(text.lines().collect::<Vec<_>>().join(" "))
}
