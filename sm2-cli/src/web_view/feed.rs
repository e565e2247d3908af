//! Samples the domain for the page: its state, which the Manager sends as it changes, and the counters of all nodes.

use std::{collections::VecDeque, io::Read, os::fd::AsFd, time::Duration};

use serde::Serialize;
use sm2_io::clock;
use sm2_proto::Instant;

use super::{
    events::{Event, Events},
    http::{Question, Requests, Site},
    schema,
};
use crate::{
    connect::CommandNode,
    doctor::{self, Check},
    ended::Ended,
    error::CliError,
    follow::Follow,
    observation::Readings,
    sampling::{Sample, Sampler},
    snapshot::{document::Document, gateways},
    top::InterfaceFigures,
    view::View,
    wait::For,
    why::Answer,
};

/// The time between two samples.
const INTERVAL: Duration = Duration::from_secs(1);

/// The time between two runs of the checks of `sm2 doctor`.
const CHECKS: Duration = Duration::from_secs(5);

/// Rates are those since the last sample, unless it is older than this.
const RATES: Duration = Duration::from_secs(5);

/// Samples the domain while a client waits for samples.
pub(super) struct Feed<'a> {
    command_node: &'a CommandNode,
    follow: Follow<'a>,
    sampler: Sampler,
    before: Option<Sample>,
    /// The number of samples so far.
    samples: u64,
    events: Events,
    /// The checks of `sm2 doctor`, and the time of the next ones.
    checks: Vec<Check>,
    checks_due: Instant,
}

/// A sample, as the page gets it.
#[derive(Serialize)]
struct Look<'e> {
    /// Its number.
    sample: u64,
    /// Whether a Manager is connected. If not, the state of the domain is the last one that is known.
    connected: bool,
    domain: Document,
    /// The figures of all granted interfaces since the last sample.
    figures: Vec<InterfaceFigures>,
    events: &'e VecDeque<Event>,
    checks: &'e [Check],
}

impl<'a> Feed<'a> {
    /// Reads the domain as it is now, within `timeout`.
    ///
    /// # Errors
    ///
    /// As [`Follow::new`].
    pub(super) fn new(command_node: &'a CommandNode, timeout: Duration) -> Result<Self, CliError> {
        let follow = Follow::new(command_node, timeout)?;
        Ok(Self {
            command_node,
            events: Events::new(&command_node.node, follow.domain()),
            follow,
            sampler: Sampler::new(),
            before: None,
            samples: 0,
            checks: Vec::new(),
            checks_due: clock::now(),
        })
    }

    /// Hands samples to `site`, and answers its questions, until a signal comes.
    ///
    /// # Errors
    ///
    /// Those of [`Follow::wait`] and [`Sampler::look`].
    pub(super) fn run(&mut self, site: &Site, requests: &Requests) -> Result<Ended, CliError> {
        let mut due = clock::now();
        loop {
            let until = site.has_clients().then_some(due);
            let woken = [(requests.woken.as_fd(), For::Reading)];
            let woken = self.follow.wait(&woken, until)?;
            if self.command_node.stopped().is_some() {
                return Ok(Ended::Done);
            }
            let node = &self.command_node.node;
            self.events.add(node, self.follow.domain(), &woken.changes);
            // The socket is non-blocking, and a byte stands for a client or a question. If it is not empty now, the
            // next wait ends at once.
            let _ = (&requests.woken).read(&mut [0; 64]);
            for asked in requests.questions.try_iter() {
                // The client may be gone.
                let _ = asked.answer.send(self.answer(&asked.question));
            }
            let now = clock::now();
            if site.has_clients() && now >= due {
                site.publish(&self.look(now)?);
                due = due.after(INTERVAL).max(now);
            }
        }
    }

    fn answer(&self, question: &Question) -> Result<Vec<String>, String> {
        match question {
            Question::Why { one, other } => {
                // Clients wait for samples meanwhile, so there is one reading of the counters.
                let never = |_| Ok(false);
                match Answer::find(self.command_node, one, other.as_ref(), never) {
                    Ok(answer) => Ok(answer.lines()),
                    Err(error) => Err(error.to_string()),
                }
            }
            Question::Schema(name) => {
                let lines =
                    schema::lines(self.command_node, &View::new(self.follow.domain()), name);
                lines.map_err(|error| error.to_string())
            }
            Question::Gateways => {
                let reports = gateways::ask(self.command_node, self.follow.domain());
                Ok(gateways::lines(&reports))
            }
        }
    }

    /// The next sample as JSON.
    fn look(&mut self, now: Instant) -> Result<Vec<u8>, CliError> {
        let domain = self.follow.domain();
        let view = View::new(domain);
        let nodes = domain.nodes().map(|node| node.node).collect();
        let sample = self.sampler.look(&self.command_node.node, domain, &nodes)?;
        let before = self.before.take().filter(|it| sample.since(it) < RATES);
        let before = before.as_ref().unwrap_or(&sample);
        let readings = Readings {
            before: Some(before),
            now: &sample,
        };
        let granted = view.granted();
        let figures = granted.map(|it| InterfaceFigures::new(&view, readings, it));
        if now >= self.checks_due {
            self.checks = doctor::checks(&view, readings, &self.command_node.node);
            self.checks_due = now.after(CHECKS);
        }
        self.samples += 1;
        let look = Look {
            sample: self.samples,
            connected: self.command_node.is_connected(),
            figures: figures.collect(),
            domain: Document::new(self.command_node, &view, readings, Vec::new()),
            events: self.events.list(),
            checks: &self.checks,
        };
        let json = serde_json::to_vec(&look).unwrap_or_default();
        self.before = Some(sample);
        Ok(json)
    }
}
