//! The conditions of `sm2 wait`: `topic:NAME publishers>=1 links>2`.
//!
//! ```text
//! expression = subject *(blanks condition)
//! subject    = ("topic" / "service" / "node") ":" NAME
//! condition  = COUNT [blanks] OP [blanks] NUMBER / "up" / "gone"
//! ```

use std::fmt;

use serde::Serialize;
use sm2_proto::{Kind, Name, domain::Domain, text::Counted};

use crate::{
    args, names,
    view::{SERVICE, TOPIC, View},
};

/// One subject and its conditions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Expression {
    /// The text from the command line.
    text: String,
    subject: Subject,
    name: Name,
    conditions: Vec<Condition>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Subject {
    Topic,
    Service,
    Node,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Condition {
    Up,
    Gone,
    Count(Count, Operator, u64),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Count {
    Of(Kind),
    Links,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Operator {
    Equal,
    NotEqual,
    AtLeast,
    AtMost,
    More,
    Less,
}

/// The longer operators come first, since `>=` starts with `>`.
const OPERATORS: [(&str, Operator); 7] = [
    ("==", Operator::Equal),
    ("!=", Operator::NotEqual),
    (">=", Operator::AtLeast),
    ("<=", Operator::AtMost),
    (">", Operator::More),
    ("<", Operator::Less),
    ("=", Operator::Equal),
];

const COUNTS: [(&str, Count); 5] = [
    ("publishers", Count::Of(Kind::Publisher)),
    ("subscribers", Count::Of(Kind::Subscriber)),
    ("servers", Count::Of(Kind::Server)),
    ("clients", Count::Of(Kind::Client)),
    ("links", Count::Links),
];

/// The counts that an expression found in a domain.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Seen {
    expression: String,
    pub(super) met: bool,
    /// Whether the node exists; only for the subject `node`.
    #[serde(skip_serializing_if = "Option::is_none")]
    up: Option<bool>,
    publishers: u64,
    subscribers: u64,
    servers: u64,
    clients: u64,
    links: u64,
}

impl Expression {
    /// Parses an expression.
    ///
    /// # Errors
    ///
    /// The position of the fault (characters count from 1), and what was expected there.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let mut words = Words { text, at: 0 };
        let start = words.skip_blanks();
        let subject_text = words.take(|c| !c.is_whitespace());
        let (kind, name_text) = subject_text
            .split_once(':')
            .ok_or_else(|| words.wrong(start, "expected topic:NAME, service:NAME or node:NAME"))?;
        let subject = match kind {
            "topic" => Subject::Topic,
            "service" => Subject::Service,
            "node" => Subject::Node,
            _ => return Err(words.wrong(start, "expected topic:, service: or node:")),
        };
        let name = args::name(name_text);
        let name = name.map_err(|error| words.wrong(start + kind.len() + 1, &error))?;
        let mut conditions = Vec::new();
        loop {
            let at = words.skip_blanks();
            if words.rest().is_empty() {
                break;
            }
            conditions.push(words.condition(subject, at)?);
        }
        if conditions.is_empty() {
            match subject {
                Subject::Node => conditions.push(Condition::Up),
                Subject::Topic | Subject::Service => {
                    let what = format!("expected a condition, such as {}", subject.example());
                    return Err(words.wrong(words.at, &what));
                }
            }
        }
        Ok(Self {
            text: text.to_owned(),
            subject,
            name,
            conditions,
        })
    }

    /// The text that was parsed.
    pub(crate) fn text(&self) -> &str {
        &self.text
    }

    /// Whether all conditions hold in the domain.
    pub(crate) fn is_met(&self, domain: &Domain) -> bool {
        self.seen(domain).met
    }

    /// The counts of the subject in the domain.
    pub(crate) fn seen(&self, domain: &Domain) -> Seen {
        let up = match self.subject {
            Subject::Node => Some(domain.node_named(self.name.as_str()).is_some()),
            Subject::Topic | Subject::Service => None,
        };
        let mut seen = Seen {
            expression: self.text.clone(),
            met: false,
            up,
            publishers: 0,
            subscribers: 0,
            servers: 0,
            clients: 0,
            links: 0,
        };
        let own = |entity| {
            domain
                .interface(entity)
                .is_some_and(|it| self.has(domain, &it))
        };
        for it in domain.interfaces().filter(|it| it.refused.is_none()) {
            if self.has(domain, &it) {
                *seen.count_of(it.contract.kind()) += 1;
            }
        }
        // A link between two interfaces of one node counts once.
        let links = domain
            .links()
            .filter(|it| own(it.offering) || own(it.demanding));
        seen.links = links.count() as u64;
        seen.met = self.conditions.iter().all(|it| it.is_met(&seen));
        seen
    }

    /// A similar name for a name that the domain does not have, with punctuation. Else an empty text.
    pub(crate) fn hint(&self, domain: &Domain) -> String {
        let view = View::new(domain);
        let known: Vec<_> = match self.subject {
            Subject::Topic => view.names(TOPIC).into_iter().collect(),
            Subject::Service => view.names(SERVICE).into_iter().collect(),
            Subject::Node => domain.nodes().map(|node| node.name).collect(),
        };
        match known.contains(&&self.name) {
            true => String::new(),
            false => names::hint(self.name.as_str(), known),
        }
    }

    /// Whether an interface is one of the subject.
    fn has(&self, domain: &Domain, it: &sm2_proto::domain::InterfaceView<'_>) -> bool {
        let kind = it.contract.kind();
        match self.subject {
            Subject::Topic => {
                matches!(kind, Kind::Publisher | Kind::Subscriber)
                    && *it.contract.name() == self.name
            }
            Subject::Service => {
                matches!(kind, Kind::Server | Kind::Client) && *it.contract.name() == self.name
            }
            Subject::Node => {
                let node = domain.node(it.entity.node);
                node.is_some_and(|node| *node.name == self.name)
            }
        }
    }
}

impl Subject {
    fn allows(self, count: Count) -> bool {
        match (self, count) {
            (Self::Topic, Count::Of(kind)) => matches!(kind, Kind::Publisher | Kind::Subscriber),
            (Self::Service, Count::Of(kind)) => matches!(kind, Kind::Server | Kind::Client),
            (Self::Node, _) | (_, Count::Links) => true,
        }
    }

    const fn example(self) -> &'static str {
        match self {
            Self::Topic => "publishers>=1, subscribers>=1 or links>=1",
            Self::Service => "servers>=1, clients>=1 or links>=1",
            Self::Node => "up, gone or links>=1",
        }
    }
}

impl Condition {
    const fn is_met(self, seen: &Seen) -> bool {
        match self {
            Self::Up => matches!(seen.up, Some(true)),
            Self::Gone => matches!(seen.up, Some(false)),
            Self::Count(count, operator, number) => {
                let value = match count {
                    Count::Of(Kind::Publisher) => seen.publishers,
                    Count::Of(Kind::Subscriber) => seen.subscribers,
                    Count::Of(Kind::Server) => seen.servers,
                    Count::Of(Kind::Client) => seen.clients,
                    Count::Links => seen.links,
                };
                match operator {
                    Operator::Equal => value == number,
                    Operator::NotEqual => value != number,
                    Operator::AtLeast => value >= number,
                    Operator::AtMost => value <= number,
                    Operator::More => value > number,
                    Operator::Less => value < number,
                }
            }
        }
    }
}

impl Seen {
    const fn count_of(&mut self, kind: Kind) -> &mut u64 {
        match kind {
            Kind::Publisher => &mut self.publishers,
            Kind::Subscriber => &mut self.subscribers,
            Kind::Server => &mut self.servers,
            Kind::Client => &mut self.clients,
        }
    }
}

/// `'topic:scan publishers>=1' is not true: 0 publishers, 2 subscribers, 0 links`
impl fmt::Display for Seen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (verb, subject) = match self.met {
            true => ("is", &self.expression),
            false => ("is not", &self.expression),
        };
        write!(f, "'{subject}' {verb} true: ")?;
        match self.up {
            Some(false) => return f.write_str("the node is not there"),
            Some(true) => f.write_str("the node is there, ")?,
            None => {}
        }
        let counts = [
            (self.publishers, "publisher"),
            (self.subscribers, "subscriber"),
            (self.servers, "server"),
            (self.clients, "client"),
        ];
        let is_topic = self.expression.trim_start().starts_with("topic:");
        let is_service = self.expression.trim_start().starts_with("service:");
        let shown = match (is_topic, is_service) {
            (true, _) => &counts[..2],
            (_, true) => &counts[2..],
            _ => &counts[..],
        };
        for (count, noun) in shown {
            write!(f, "{}, ", Counted::new(*count, noun))?;
        }
        write!(f, "{}", Counted::new(self.links, "link"))
    }
}

/// The text of an expression, and the position of the parser.
struct Words<'a> {
    text: &'a str,
    at: usize,
}

impl<'a> Words<'a> {
    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    /// Skips blanks, and returns the position of the next character.
    fn skip_blanks(&mut self) -> usize {
        self.take(char::is_whitespace);
        self.at
    }

    fn take(&mut self, is_part: impl Fn(char) -> bool) -> &'a str {
        let rest = self.rest();
        let len = rest.find(|c| !is_part(c)).unwrap_or(rest.len());
        self.at += len;
        &rest[..len]
    }

    fn condition(&mut self, subject: Subject, start: usize) -> Result<Condition, String> {
        let word = self.take(|c| c.is_ascii_alphabetic());
        match (word, subject) {
            ("up", Subject::Node) => return self.end_of_word(Condition::Up),
            ("gone", Subject::Node) => return self.end_of_word(Condition::Gone),
            _ => {}
        }
        let known = COUNTS.iter().find(|(name, _)| *name == word);
        let Some(&(_, count)) = known.filter(|(_, count)| subject.allows(*count)) else {
            return Err(self.wrong(start, &format!("expected {}", subject.example())));
        };
        let at = self.skip_blanks();
        let rest = self.rest();
        let operator = OPERATORS.iter().find(|(sign, _)| rest.starts_with(sign));
        let Some((sign, operator)) = operator else {
            return Err(self.wrong(at, "expected one of == != >= <= > <"));
        };
        self.at += sign.len();
        let at = self.skip_blanks();
        let digits = self.take(|c| !c.is_whitespace());
        let number = digits.parse();
        let number = number.map_err(|_| self.wrong(at, "expected a whole number, such as 1"))?;
        Ok(Condition::Count(count, *operator, number))
    }

    fn end_of_word(&self, condition: Condition) -> Result<Condition, String> {
        match self.rest().chars().next() {
            None => Ok(condition),
            Some(c) if c.is_whitespace() => Ok(condition),
            Some(_) => Err(self.wrong(self.at, "expected a blank or the end")),
        }
    }

    /// An error with its position. Characters count from 1.
    fn wrong(&self, at: usize, what: &str) -> String {
        let position = self.text[..at.min(self.text.len())].chars().count() + 1;
        let found = self.text.get(at..).unwrap_or("");
        match found.split_whitespace().next() {
            Some(word) => format!("at character {position} ({word}): {what}"),
            None => format!("at character {position} (the end): {what}"),
        }
    }
}

#[cfg(test)]
mod tests;
