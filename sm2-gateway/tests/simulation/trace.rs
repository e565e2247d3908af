//! The outputs of a hub as text.

use sm2_gateway::{
    hub::{LocalCommand, Output},
    peer::Command,
};

/// Describes an output in one line, without the bytes of payloads.
pub(crate) fn text(output: &Output) -> String {
    match output {
        Output::Peer {
            connection,
            command,
        } => format!("to {}: {}", connection.0, command_text(command)),
        Output::Local(command) => local_text(command),
        it => format!("{it:?}"),
    }
}

fn command_text(command: &Command) -> String {
    match command {
        Command::Offer {
            offer,
            subject,
            path,
            ..
        } => format!("offer {} {} by {}", offer.0, subject.name(), path.len()),
        Command::Message { offer, message } => format!(
            "message {} {}, {} bytes",
            offer.0,
            message.sequence,
            message.payload.len()
        ),
        Command::Call { call, offer, .. } => format!("call {} of {}", call.0, offer.0),
        Command::Reply { call, outcome, .. } => format!("reply {} {outcome:?}", call.0.0),
        it => format!("{it:?}"),
    }
}

fn local_text(command: &LocalCommand) -> String {
    match command {
        LocalCommand::Publish {
            subject, payload, ..
        } => format!("publish {} {} bytes", subject.name(), payload.len()),
        LocalCommand::DeclareProxy {
            subject,
            origin,
            peer,
        } => format!("show {subject:?} {} {peer}", short(&origin.to_string())),
        LocalCommand::WithdrawProxy { subject, origin } => {
            format!("hide {subject:?} {}", short(&origin.to_string()))
        }
        LocalCommand::Call { call, subject, .. } => format!("serve {} {}", call.0, subject.name()),
        LocalCommand::Reply {
            request, outcome, ..
        } => format!("answer {} {outcome:?}", request.0),
        it => format!("{it:?}"),
    }
}

fn short(id: &str) -> &str {
    &id[..8]
}
