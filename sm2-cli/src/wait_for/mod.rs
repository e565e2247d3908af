//! `sm2 wait`: waits until conditions on the domain hold. [`expression`] has their grammar.

mod expression;
#[cfg(feature = "fuzzing")]
pub(crate) mod fuzz;

use std::time::Duration;

use clap::Args;
use serde::Serialize;
use sm2_io::clock;
use sm2_proto::domain::Domain as Mirror;

pub(crate) use self::expression::Expression;
use self::expression::Seen;
use crate::{
    connect::CommandNode, ended::Ended, error::CliError, follow::Follow, output::Output,
    report::Options, time,
};

/// `sm2 wait`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    /// A condition such as 'topic:/scan publishers>=1'. Several must hold at the same time
    #[arg(value_name = "EXPRESSION", required = true, value_parser = Expression::parse)]
    expressions: Vec<Expression>,
    /// Give up after this time [default: never]
    #[arg(long, value_name = "TIME", value_parser = time::span_or_zero)]
    timeout: Option<Duration>,
    #[command(flatten)]
    options: Options,
}

const HELP: &str = "\
Format:
  topic:NAME CONDITION...    conditions: publishers, subscribers, links
  service:NAME CONDITION...  conditions: servers, clients, links
  node:NAME [CONDITION...]   conditions: up (the default), gone, publishers, subscribers, servers,
                             clients, links
A condition is `up`, `gone`, or a count with one of == != >= <= > < and a number; = means ==. All
counts of a topic, service or node that does not exist are 0. The wait continues while no Manager
runs.

Exit status: 0 all conditions hold, 1 the timeout passed (standard error has the last counts), 2 wrong
usage, 130 Ctrl-C.

Examples:
  sm2 wait 'topic:/scan publishers>=1 subscribers>=2' --timeout 5s
  sm2 wait node:driver 'service:sum servers==1'
  sm2 wait 'node:driver gone' --timeout 10s && echo it is down";

/// The object that `--json` prints.
#[derive(Serialize)]
struct Answer {
    /// Whether all conditions hold.
    met: bool,
    /// The domain's revision.
    revision: u64,
    waited_s: f64,
    expressions: Vec<Seen>,
}

/// Runs the command.
///
/// # Errors
///
/// Any [`CliError`].
pub(crate) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    let command_node = CommandNode::open(&arguments.options.domain, "wait")?;
    let start = clock::now();
    let until = arguments.timeout.map(|timeout| start.after(timeout));
    let mut follow = Follow::new(&command_node, arguments.options.domain.connect_timeout)?;
    let met = loop {
        if arguments
            .expressions
            .iter()
            .all(|it| it.is_met(follow.domain()))
        {
            break true;
        }
        command_node.fail_if_stopped()?;
        if until.is_some_and(|until| until <= clock::now()) {
            break false;
        }
        follow.wait(&[], until)?;
    };
    let seen = seen(&arguments.expressions, follow.domain());
    if !met {
        let unmet = arguments.expressions.iter().zip(&seen);
        for (expression, seen) in unmet.filter(|(_, seen)| !seen.met) {
            stderr_line!("sm2: {seen}{}", expression.hint(follow.domain()));
        }
    }
    if arguments.options.json {
        let waited = clock::now().since(start).as_secs_f64();
        Output::new().json(&Answer {
            met,
            revision: follow.domain().revision(),
            waited_s: (waited * 1e3).round() / 1e3,
            expressions: seen,
        })?;
    }
    Ok(Ended::with_answer(met))
}

fn seen(expressions: &[Expression], domain: &Mirror) -> Vec<Seen> {
    expressions.iter().map(|it| it.seen(domain)).collect()
}
