//! The commands of a node.
//!
//! | command | answer |
//! | --- | --- |
//! | `pub`, `sub`, `server`, `client` `KEY NAME WORDS…` | `ok matched=N` |
//! | `wait KEY N` | `ok` when N links are open |
//! | `publish KEY COUNT SIZE` | `ok took=N missed=N`: the sums over all messages |
//! | `take KEY COUNT` | `ok got=N bytes=N first=N last=N lost=N damaged=N`, when COUNT messages have come |
//! | `drain KEY` | the answer of `take`, for the messages that have arrived |
//! | `hold KEY COUNT` | the answer of `take`; the messages are released by `free KEY` |
//! | `check KEY` | `ok got=N damaged=N`, for the held messages |
//! | `counters KEY` | `ok`, and for each link ` \| peer=… open=… offered=… …` |
//! | `call KEY SIZE` | `ok` when the request was sent |
//! | `reply KEY` | `ok got=1 …` for the oldest call |
//! | `serve KEY COUNT` | `ok` when COUNT requests have been answered with their own payloads |
//! | `accept KEY` | `ok` when a request was taken, which `answer KEY` answers |
//! | `withdraw KEY` | `ok` when the interface is dropped; its held messages stay |
//! | `close KEY` | `ok` when the held messages are dropped, too |
//! | `describe NAME HASH` | `ok`, and the text of a type |
//! | `eat` | `ok` when the process has no descriptor left, until `spit` |

use std::{
    collections::{HashMap, VecDeque},
    fmt::{Debug, Display, Write as _},
    fs::File,
};

use sm2_node::diagnostics::{Fate, LinkStatus};

use sm2_node::{Call, Client, Node, Publisher, Request, Sample, Server, Subscriber, TypeId};
use sm2_tests::{TIMEOUT, pattern};

use super::declare::{self, Words};

/// A map by the key of the interface.
type ByKey<T> = HashMap<String, T>;
/// An interface, with the number of messages that it has sent.
type Counting<T> = (T, u64);
/// An interface, with the number of the next expected message.
type Expecting<T> = (T, u64);

pub(super) struct Stage {
    node: Node,
    publishers: ByKey<Counting<Publisher<[u8]>>>,
    subscribers: ByKey<Subscriber<[u8]>>,
    servers: ByKey<Server<[u8], [u8]>>,
    clients: ByKey<Counting<Client<[u8], [u8]>>>,
    samples: ByKey<Vec<Sample<[u8]>>>,
    calls: ByKey<VecDeque<Expecting<Call<[u8]>>>>,
    requests: ByKey<Request<[u8], [u8]>>,
    eaten: Vec<File>,
}

/// The answer to a command, or its error.
type Answer = Result<String, String>;

impl Stage {
    pub(super) fn new(node: Node) -> Self {
        Self {
            node,
            publishers: HashMap::new(),
            subscribers: HashMap::new(),
            servers: HashMap::new(),
            clients: HashMap::new(),
            samples: HashMap::new(),
            calls: HashMap::new(),
            requests: HashMap::new(),
            eaten: Vec::new(),
        }
    }

    pub(super) fn execute(&mut self, line: &str) -> String {
        let words: Vec<&str> = line.split_whitespace().collect();
        let answer = match *words.as_slice() {
            [
                kind @ ("pub" | "sub" | "server" | "client"),
                key,
                name,
                ref rest @ ..,
            ] => self.declare(kind, key, name, &Words(rest)),
            ["wait", key, count] => self.wait(key, number(count)),
            ["publish", key, count, size] => self.publish(key, number(count), number(size)),
            ["take", key, count] => self.receive(key, Some(number(count)), false),
            ["drain", key] => self.receive(key, None, false),
            ["hold", key, count] => self.receive(key, Some(number(count)), true),
            ["free", key] => Ok(self.free(key)),
            ["check", key] => Ok(self.check(key)),
            ["counters", key] => self.counters(key),
            ["call", key, size] => self.call(key, number(size)),
            ["reply", key] => self.reply(key),
            ["serve", key, count] => self.serve(key, number(count)),
            ["accept", key] => self.accept(key),
            ["answer", key] => self.answer(key),
            ["withdraw", key] => Ok(self.withdraw(key)),
            ["close", key] => Ok(self.close(key)),
            ["describe", name, hash] => self.describe(name, number(hash)),
            ["eat"] => Ok(self.eat()),
            ["spit"] => {
                self.eaten.clear();
                Ok(String::new())
            }
            _ => Err(format!("no such command: {line}")),
        };
        match answer {
            Ok(text) if text.is_empty() => "ok".to_owned(),
            Ok(text) => format!("ok {text}"),
            Err(text) => format!("error {text}"),
        }
    }

    fn declare(&mut self, kind: &str, key: &str, name: &str, words: &Words<'_>) -> Answer {
        let node = &self.node;
        let key = key.to_owned();
        let matched;
        match kind {
            "pub" => {
                let publisher = declare::publisher(node, name, words).map_err(text)?;
                matched = publisher.matched();
                self.publishers.insert(key, (publisher, 0));
            }
            "sub" => {
                let subscriber = declare::subscriber(node, name, words).map_err(text)?;
                matched = subscriber.matched();
                self.subscribers.insert(key, subscriber);
            }
            "server" => {
                let server = declare::server(node, name, words).map_err(text)?;
                matched = server.matched();
                self.servers.insert(key, server);
            }
            _ => {
                let client = declare::client(node, name, words).map_err(text)?;
                matched = client.matched();
                self.clients.insert(key, (client, 0));
            }
        }
        Ok(format!("matched={matched}"))
    }

    fn wait(&self, key: &str, count: usize) -> Answer {
        let time = TIMEOUT;
        let done = if let Some((publisher, _)) = self.publishers.get(key) {
            publisher.wait_for_subscribers_timeout(count, time)
        } else if let Some(subscriber) = self.subscribers.get(key) {
            subscriber.wait_for_publishers_timeout(count, time)
        } else if let Some(server) = self.servers.get(key) {
            server.wait_for_clients_timeout(count, time)
        } else if let Some((client, _)) = self.clients.get(key) {
            client.wait_for_servers_timeout(count, time)
        } else {
            return Err(format!("no interface {key}"));
        };
        done.map(|()| String::new()).map_err(text)
    }

    fn publish(&mut self, key: &str, count: usize, size: usize) -> Answer {
        let (publisher, published) = self.publishers.get_mut(key).ok_or("no publisher")?;
        let (mut took, mut missed) = (0, 0);
        for _ in 0..count {
            let message = pattern::message(*published + 1, size);
            let result = publisher.publish(&message).map_err(text)?;
            *published += 1;
            took += result.links;
            missed += result.missed;
        }
        Ok(format!("took={took} missed={missed}"))
    }

    /// Receives `count` messages; without a count, all that have arrived.
    fn receive(&mut self, key: &str, count: Option<usize>, hold: bool) -> Answer {
        let subscriber = self.subscribers.get(key).ok_or("no subscriber")?;
        let mut seen = Seen::default();
        let mut held = Vec::new();
        while count.is_none_or(|count| seen.got < count) {
            let sample = match count {
                Some(_) => subscriber.recv_timeout(TIMEOUT),
                None => subscriber.try_recv(),
            };
            let Some(sample) = sample.map_err(text)? else {
                break;
            };
            seen.note(sample.sequence(), sample.lost(), &sample);
            if hold {
                held.push(sample);
            }
        }
        self.samples.entry(key.to_owned()).or_default().extend(held);
        match count {
            Some(count) if seen.got < count => Err(format!("in vain after {seen}")),
            _ => Ok(seen.to_string()),
        }
    }

    fn free(&mut self, key: &str) -> String {
        let freed = self.samples.remove(key).unwrap_or_default();
        format!("freed={}", freed.len())
    }

    fn check(&self, key: &str) -> String {
        let samples = self.samples.get(key).map_or(&[][..], Vec::as_slice);
        let damaged = |sample: &&Sample<[u8]>| !pattern::is_intact(sample, sample.sequence());
        let damaged = samples.iter().filter(damaged).count();
        format!("got={} damaged={damaged}", samples.len())
    }

    fn describe(&self, name: &str, hash: usize) -> Answer {
        let name = name.parse().map_err(text)?;
        let hash = hash as u64;
        let described = self.node.describe(&TypeId { name, hash });
        Ok(described.map_err(text)?.unwrap_or_default())
    }

    fn counters(&self, key: &str) -> Answer {
        let links = if let Some((publisher, _)) = self.publishers.get(key) {
            publisher.links()
        } else if let Some((client, _)) = self.clients.get(key) {
            client.links()
        } else {
            return Err(format!("no publisher or client {key}"));
        };
        Ok(links.iter().map(describe).collect())
    }

    fn call(&mut self, key: &str, size: usize) -> Answer {
        let (client, called) = self.clients.get_mut(key).ok_or("no client")?;
        *called += 1;
        let request = pattern::message(*called, size);
        let call = client.send_timeout(&request, TIMEOUT).map_err(text)?;
        let calls = self.calls.entry(key.to_owned()).or_default();
        calls.push_back((call, *called));
        Ok(String::new())
    }

    fn reply(&mut self, key: &str) -> Answer {
        let calls = self.calls.get_mut(key).ok_or("no call")?;
        let (call, number) = calls.pop_front().ok_or("no call")?;
        let reply = call.wait().map_err(text)?;
        let mut seen = Seen::default();
        seen.note(number, 0, &reply);
        Ok(format!("{seen} server={}", reply.server()))
    }

    fn serve(&self, key: &str, count: usize) -> Answer {
        let server = self.servers.get(key).ok_or("no server")?;
        for served in 0..count {
            let request = server.recv_timeout(TIMEOUT).map_err(text)?;
            let request = request.ok_or_else(|| format!("in vain after {served}"))?;
            echo(request)?;
        }
        Ok(String::new())
    }

    fn accept(&mut self, key: &str) -> Answer {
        let server = self.servers.get(key).ok_or("no server")?;
        let request = server.recv_timeout(TIMEOUT).map_err(text)?;
        let request = request.ok_or("in vain")?;
        self.requests.insert(key.to_owned(), request);
        Ok(String::new())
    }

    fn answer(&mut self, key: &str) -> Answer {
        echo(self.requests.remove(key).ok_or("no request")?)
    }

    fn eat(&mut self) -> String {
        let more = std::iter::from_fn(|| File::open("/dev/null").ok());
        self.eaten.extend(more);
        format!("eaten={}", self.eaten.len())
    }

    fn close(&mut self, key: &str) -> String {
        self.calls.remove(key);
        self.samples.remove(key);
        self.requests.remove(key);
        self.withdraw(key)
    }

    fn withdraw(&mut self, key: &str) -> String {
        self.publishers.remove(key);
        self.subscribers.remove(key);
        self.servers.remove(key);
        self.clients.remove(key);
        String::new()
    }
}

/// Counts of received messages.
#[derive(Default)]
struct Seen {
    got: usize,
    bytes: usize,
    first: u64,
    last: u64,
    lost: u64,
    damaged: usize,
}

impl Seen {
    fn note(&mut self, number: u64, lost: u64, payload: &[u8]) {
        if self.got == 0 {
            self.first = number;
        }
        self.got += 1;
        self.bytes += payload.len();
        self.last = number;
        self.lost += lost;
        self.damaged += usize::from(!pattern::is_intact(payload, number));
    }
}

impl Display for Seen {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            got,
            bytes,
            first,
            last,
            lost,
            damaged,
        } = self;
        write!(
            f,
            "got={got} bytes={bytes} first={first} last={last} lost={lost} damaged={damaged}"
        )
    }
}

/// Answers a request with its own payload.
fn echo(request: Request<[u8], [u8]>) -> Answer {
    let reply = request.to_vec();
    request.reply(&reply).map_err(text)?;
    Ok(String::new())
}

fn describe(link: &LinkStatus) -> String {
    let counters = &link.counters;
    let mut text = format!(
        " | peer={} open={} reliable={} sealed={}",
        link.peer.name, link.open, link.reliable, link.sealed
    );
    let _ = write!(text, " offered={}", counters.offered);
    for fate in Fate::ALL {
        let _ = write!(text, " {fate}={}", counters.of(fate));
    }
    let _ = write!(text, " in_flight={}", counters.in_flight);
    text
}

fn number(word: &str) -> usize {
    word.parse().unwrap_or_else(|_| panic!("no number: {word}"))
}

fn text(error: impl Debug + Display) -> String {
    format!("{error:?}: {error}")
}
