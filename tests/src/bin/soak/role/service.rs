//! `server` and `client`: a server answers each request with its bytes, and a client checks them.

use std::time::Duration;

use sm2_node::{Call, CallError, Client, Node, Server, diagnostics::LinkStatus};
use sm2_tests::{TIMEOUT, options::Options, random::Random};

use super::work::{Work, random_len};
use crate::{
    message::{self, HEADER_BYTES},
    tally::Tally,
};

/// The number of calls that a client has in flight.
const CALLS: usize = 4;
/// The length of the longest request: several segments of memory have slots for it.
const MOST: usize = 70_000;

pub(super) struct Serving(Server<[u8], [u8]>);

impl Serving {
    pub(super) fn new(node: &Node, options: &Options) -> Self {
        let service: String = options.get("--topic").expect("--topic");
        Self(node.server::<[u8], [u8]>(&service).expect("a server"))
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
            Ok(None) => {}
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
    resting: bool,
}

impl Calling {
    pub(super) fn new(node: &Node, options: &Options) -> Self {
        let service: String = options.get("--topic").expect("--topic");
        let instance = message::new_instance();
        Self {
            client: node.client(&service).expect("a client"),
            calls: Vec::new(),
            instance,
            number: 0,
            random: Random::new(instance),
            resting: false,
        }
    }

    fn call(&mut self, tally: &mut Tally) {
        self.number += 1;
        let len = random_len(&mut self.random, HEADER_BYTES, MOST);
        let mut request = vec![0; len];
        message::fill(&mut request, self.instance, self.number);
        match self.client.send_timeout(&request, TIMEOUT) {
            Ok(call) => self.calls.push((request, call)),
            Err(error) => judge(&error, tally),
        }
    }

    /// Takes the replies that have arrived. Each call ends once: with its reply, or with its server.
    fn take(&mut self, tally: &mut Tally) {
        self.calls
            .retain_mut(|(request, call)| match call.try_wait() {
                Ok(None) => true,
                Ok(Some(reply)) => {
                    tally.checked += 1;
                    if *reply != **request {
                        tally.damaged(&format!("a reply of {}", reply.server()));
                    }
                    false
                }
                Err(error) => {
                    judge(&error, tally);
                    false
                }
            });
    }
}

/// The death of a server, and a lack of memory or descriptors, are no faults.
fn judge(error: &CallError, tally: &mut Tally) {
    match error {
        CallError::ServerGone { .. }
        | CallError::NoServer { .. }
        | CallError::Store(_)
        | CallError::Map { .. } => {}
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
