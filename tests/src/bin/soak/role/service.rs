//! `server` and `client`: a server answers each request with its bytes, and a client checks them.

use std::time::Duration;

use sm2_node::{Call, CallError, Client, Node, RecvError, Server, diagnostics::LinkStatus};
use sm2_tests::{TIMEOUT, options::Options, random::Random};

use super::work::{Work, patient, random_len};
use crate::{
    message::{self, HEADER_BYTES},
    tally::Tally,
};

/// The number of calls that a client has in flight.
const CALLS: usize = 4;
/// The default length of the longest request: several segments of memory have slots for it.
const MOST: usize = 70_000;
/// The timeout of a call of the other domain.
const REMOTE_TIMEOUT: Duration = Duration::from_secs(10);

pub(super) struct Serving(Server<[u8], [u8]>);

impl Serving {
    pub(super) fn new(node: &Node, options: &Options) -> Self {
        let service: String = options.get("--topic").expect("--topic");
        Self(patient("server", || node.server(&service)))
    }
}

impl Work for Serving {
    fn turn(&mut self, tally: &mut Tally) {
        match self.0.recv_timeout(Duration::from_millis(5)) {
            Ok(Some(request)) => {
                tally.checked += 1;
                if message::check(&request).is_none() {
                    tally.damaged(&format!("a request of {}", request.client()));
                }
                let reply = request.to_vec();
                // A client that died needs no reply.
                let _ = request.reply(&reply);
            }
            // A process without descriptors or memory loses a link, and its client the calls.
            Ok(None) | Err(RecvError::Map { .. }) => {}
            Err(error) => tally.error(&error.to_string()),
        }
    }

    fn set_resting(&mut self, _resting: bool) {}

    fn is_settled(&mut self) -> bool {
        true
    }

    fn links(&self) -> Vec<LinkStatus> {
        self.0.links()
    }
}

pub(super) struct Calling {
    client: Client<[u8], [u8]>,
    calls: Vec<(Vec<u8>, Call<[u8]>)>,
    instance: u64,
    number: u64,
    random: Random,
    /// The range of lengths, in bytes.
    lengths: (usize, usize),
    /// Whether the servers are in the other domain.
    is_remote: bool,
    resting: bool,
}

impl Calling {
    pub(super) fn new(node: &Node, options: &Options) -> Self {
        let service: String = options.get("--topic").expect("--topic");
        let instance = message::new_instance();
        Self {
            client: patient("client", || node.client(&service)),
            lengths: (
                options.get_or("--least", HEADER_BYTES),
                options.get_or("--most", MOST),
            ),
            is_remote: options.get_or("--remote", false),
            calls: Vec::new(),
            instance,
            number: 0,
            random: Random::new(instance),
            resting: false,
        }
    }

    fn call(&mut self, tally: &mut Tally) {
        self.number += 1;
        let (least, most) = self.lengths;
        let len = random_len(&mut self.random, least, most);
        let mut request = vec![0; len];
        message::fill(&mut request, self.instance, self.number);
        let timeout = if self.is_remote {
            REMOTE_TIMEOUT
        } else {
            TIMEOUT
        };
        match self.client.send_timeout(&request, timeout) {
            Ok(call) => self.calls.push((request, call)),
            Err(error) => judge(&error, self.is_remote, tally),
        }
    }

    /// Takes the replies that have arrived. Each call ends once: with its reply, or with its server.
    fn take(&mut self, tally: &mut Tally) {
        let is_remote = self.is_remote;
        self.calls
            .retain_mut(|(request, call)| match call.try_wait() {
                Ok(None) => true,
                Ok(Some(reply)) => {
                    tally.checked += 1;
                    tally.remote += u64::from(is_remote);
                    if *reply != **request {
                        tally.damaged(&format!("a reply of {}", reply.server()));
                    }
                    false
                }
                Err(error) => {
                    judge(&error, is_remote, tally);
                    false
                }
            });
    }
}

/// The beginning of the reason of a server that had no memory or descriptors for its reply, as sm2-node words it.
const NOT_STORED: &str = "the server could not store the reply";

/// Whether this is the reason of a server that could not store its reply: alone, or with the error behind a colon.
fn is_not_stored(reason: &str) -> bool {
    let rest = reason.strip_prefix(NOT_STORED);
    rest.is_some_and(|it| it.is_empty() || it.starts_with(": "))
}

/// The death of a server, and a lack of memory or descriptors at either end, are not faults. A gateway that has lost
/// its peer reports that as a failure, and the bad link may be too slow.
fn judge(error: &CallError, is_remote: bool, tally: &mut Tally) {
    match error {
        CallError::Failed { .. } | CallError::DeadlineExceeded { .. } if is_remote => {}
        CallError::ServerGone { .. }
        | CallError::NoServer { .. }
        | CallError::Store(_)
        | CallError::Map { .. } => {}
        CallError::Failed { reason, .. } if is_not_stored(reason) => {}
        CallError::DeadlineExceeded { .. } => tally.unaccounted(1, &error.to_string()),
        error => tally.error(&error.to_string()),
    }
}

impl Work for Calling {
    fn turn(&mut self, tally: &mut Tally) {
        if !self.resting && self.calls.len() < CALLS {
            self.call(tally);
        }
        self.take(tally);
        std::thread::sleep(Duration::from_millis(1));
    }

    fn set_resting(&mut self, resting: bool) {
        self.resting = resting;
    }

    fn is_settled(&mut self) -> bool {
        self.calls.is_empty()
    }

    fn links(&self) -> Vec<LinkStatus> {
        self.client.links()
    }
}

#[cfg(test)]
mod tests {
    use sm2_proto::Name;

    use super::*;

    /// Whether a client in the domain of its server reports this reason as an error.
    fn is_reported(reason: &str) -> bool {
        let mut tally = Tally::default();
        let error = CallError::Failed {
            service: Name::new("echo").unwrap(),
            reason: reason.to_owned(),
        };
        judge(&error, false, &mut tally);
        tally.errors > 0
    }

    #[test]
    fn of_the_failures_of_a_server_only_a_reply_that_was_not_stored_is_no_fault() {
        for reason in [
            NOT_STORED.to_owned(),
            format!("{NOT_STORED}: Too many open files (os error 24)"),
        ] {
            assert!(!is_reported(&reason), "{reason}");
        }
        for reason in [
            "the server dropped the request without an answer".to_owned(),
            format!("{NOT_STORED}s"),
            format!("echo: {NOT_STORED}"),
            String::new(),
        ] {
            assert!(is_reported(&reason), "{reason}");
        }
    }
}
