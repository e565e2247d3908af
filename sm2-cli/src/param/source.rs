//! Reading the parameters of nodes, and setting them.

use std::{collections::BTreeSet, os::fd::AsFd, time::Duration};

use sm2_io::clock;
use sm2_node::{
    CallError, Message, Subscriber,
    params::{
        self, Assignment, Entry, SetParameters, SetParametersResult, Table, limits::TABLE_MAX,
    },
};
use sm2_proto::{Kind, Name, domain::Domain as Mirror};

use super::error::ParamError;
use crate::{connect::CommandNode, error::CliError, names, service::ask, time::Span, wait::For};

/// The parameters of one node, as they change.
pub(super) struct Source {
    pub(super) node: Name,
    tables: Subscriber<Table>,
}

impl Source {
    /// Subscribes to the parameters of a node.
    ///
    /// # Errors
    ///
    /// [`CliError::Unknown`] if the domain has no such node, [`ParamError::None`] if the node has no parameters.
    pub(super) fn open(command_node: &CommandNode, node: &Name) -> Result<Self, CliError> {
        let domain = command_node.snapshot()?;
        let with_parameters = nodes(&domain);
        if with_parameters.contains(node) {
            return Self::subscribe(command_node, node);
        }
        if domain.node_named(node.as_str()).is_some() {
            return Err(ParamError::None { node: node.clone() }.into());
        }
        Err(names::unknown("node", node, &with_parameters))
    }

    /// Subscribes to the parameters of a node that has some.
    pub(super) fn subscribe(command_node: &CommandNode, node: &Name) -> Result<Self, CliError> {
        let builder = command_node
            .node
            .subscriber_builder(&params::name(node.as_str()));
        let tables = builder.depth(16).max_len(TABLE_MAX as u64).declare()?;
        Ok(Self {
            node: node.clone(),
            tables,
        })
    }

    /// The next table, if one has come.
    ///
    /// # Errors
    ///
    /// [`ParamError::WrongTable`], [`CliError::Receive`].
    //= SM2-PRM-005
    pub(super) fn try_next(&self) -> Result<Option<Table>, CliError> {
        let Some(sample) = self.tables.try_recv()? else {
            return Ok(None);
        };
        let table: Table = (*sample).clone();
        match table.check() {
            Ok(()) => Ok(Some(table)),
            Err(problem) => {
                let node = self.node.clone();
                Err(ParamError::WrongTable { node, problem }.into())
            }
        }
    }

    /// Waits for the next table; `None` if a signal came first, or the time limit has passed.
    pub(super) fn next(
        &self,
        command_node: &CommandNode,
        timeout: Option<Duration>,
    ) -> Result<Option<Table>, CliError> {
        let until = timeout.map(|it| clock::now().after(it));
        loop {
            let table = self.try_next()?;
            let is_over = until.is_some_and(|it| clock::now() >= it);
            if table.is_some() || is_over || command_node.stopped().is_some() {
                return Ok(table);
            }
            command_node.step(&[(self.tables.as_fd(), For::Reading)], until)?;
        }
    }

    /// The present table of the node.
    ///
    /// # Errors
    ///
    /// [`ParamError::NoTable`], [`ParamError::WrongTable`], [`CliError::Stopped`].
    pub(super) fn first(
        &self,
        command_node: &CommandNode,
        timeout: Duration,
    ) -> Result<Table, CliError> {
        if let Some(table) = self.next(command_node, Some(timeout))? {
            return Ok(table);
        }
        command_node.fail_if_stopped()?;
        let (node, timeout) = (self.node.clone(), Span(timeout));
        Err(ParamError::NoTable { node, timeout }.into())
    }
}

/// The present table of a node.
///
/// # Errors
///
/// Those of [`Source::open`] and [`Source::first`].
pub(super) fn table(
    command_node: &CommandNode,
    node: &Name,
    timeout: Duration,
) -> Result<Table, CliError> {
    Source::open(command_node, node)?.first(command_node, timeout)
}

/// The nodes with parameters, also those of other domains that a gateway shows here.
pub(crate) fn nodes(domain: &Mirror) -> BTreeSet<Name> {
    let granted = domain.interfaces().filter(|it| it.refused.is_none());
    let publishers = granted.filter(|it| it.contract.kind() == Kind::Publisher);
    let nodes = publishers.filter_map(|it| {
        let node = params::node_of(it.contract.name().as_str())?;
        Name::new(node).ok()
    });
    nodes.collect()
}

/// The parameter of this name.
///
/// # Errors
///
/// [`ParamError::Unknown`].
pub(super) fn entry<'a>(
    table: &'a Table,
    node: &Name,
    name: &str,
) -> Result<&'a Entry, ParamError> {
    table.get(name).ok_or_else(|| {
        let known = table.parameters.iter().map(|it| it.name.as_str());
        ParamError::Unknown {
            node: node.clone(),
            name: name.to_owned(),
            hint: names::hint_of(name, known),
        }
    })
}

/// Sets parameters, all of them or none, and returns the revision after it.
///
/// # Errors
///
/// [`ParamError::Refused`], [`ParamError::NoAnswer`], and those of a call.
pub(super) fn set(
    command_node: &CommandNode,
    node: &Name,
    parameters: Vec<Assignment>,
    timeout: Duration,
) -> Result<u64, CliError> {
    let service = params::name(node.as_str());
    let request = SetParameters { parameters };
    let (Ok(service), Ok(request)) = (Name::new(&service), request.bytes()) else {
        return Err(ParamError::None { node: node.clone() }.into());
    };
    let node = node.clone();
    let reply = match ask(command_node, &service, &request, timeout) {
        Err(CliError::Call(CallError::DeadlineExceeded { .. })) => {
            let timeout = Span(timeout);
            return Err(ParamError::NoAnswer { node, timeout }.into());
        }
        reply => reply?,
    };
    match SetParametersResult::view(reply.into()) {
        Ok(result) if result.successful => Ok(result.revision),
        Ok(result) => {
            let reason = result.reason.clone();
            Err(ParamError::Refused { node, reason }.into())
        }
        Err(_) => Err(ParamError::WrongReply { node }.into()),
    }
}
