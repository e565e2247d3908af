//! Declaring the parameters of a node.

use std::env;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use super::changes::Changes;
use super::core::{Core, Parameter, Shared};
use super::environment::FILE_VARIABLE;
use super::error::ParametersError;
use super::file::File;
use super::limits::TABLE_MAX;
use super::parameters::Parameters;
use super::range::Range;
use super::resolve::resolve;
use super::table::{Entry, Origin, SetParameters, SetParametersResult};
use super::topic::name;
use super::value::ParameterType;
use crate::clock::wall_time;
use crate::{Node, Server};

impl Node {
    /// Returns a builder for the parameters of this node: see [`params`](super). A node declares its parameters once.
    pub fn parameters_builder(&self) -> ParametersBuilder {
        ParametersBuilder {
            node: self.clone(),
            files: Vec::new(),
            entries: Vec::new(),
            table: Arc::default(),
        }
    }
}

/// Declares the parameters of a node: see [`params`](super).
#[derive(Debug)]
#[must_use = "a builder does nothing until declare is called"]
pub struct ParametersBuilder {
    node: Node,
    files: Vec<PathBuf>,
    entries: Vec<Entry>,
    table: Shared,
}

impl ParametersBuilder {
    /// Reads values from these files as well, such as those of an option `--params` of the program. A later file has
    /// precedence over an earlier one, and all of them over that of `SM2_PARAMS`.
    pub fn files(mut self, paths: impl IntoIterator<Item = impl Into<PathBuf>>) -> Self {
        self.files.extend(paths.into_iter().map(Into::into));
        self
    }

    /// Describes a parameter; [`add`](ParameterBuilder::add) adds it. Its type is that of the default.
    ///
    /// The name consists of segments of `A-Z a-z 0-9 _ -`, joined by single `.`, and has at most 255 bytes.
    pub fn parameter<T: ParameterType>(
        &mut self,
        name: &str,
        default: T,
    ) -> ParameterBuilder<'_, T> {
        ParameterBuilder {
            entry: Entry {
                name: name.to_owned(),
                value: default.clone().into_value(),
                origin: Origin::Default,
                revision: 1,
                read_only: false,
                range: None,
                description: String::new(),
            },
            default,
            builder: self,
        }
    }

    /// Declares the parameters. A thread, `sm2-parameters`, accepts every change that types and ranges allow, so
    /// the program need not do anything. All signals are blocked in it, and it inherits the scheduling policy, the
    /// priority and the affinity of this thread. It drives a node that has no background thread of its own.
    ///
    /// # Errors
    ///
    /// See [`ParametersError`].
    pub fn declare(self) -> Result<Parameters, ParametersError> {
        let node = self.node.clone();
        let (core, server) = self.declare_interfaces()?;
        Parameters::of_thread(core, server, node.name().as_str())
    }

    /// Declares the parameters. The program accepts or refuses each change.
    ///
    /// # Errors
    ///
    /// See [`ParametersError`].
    pub fn declare_with_changes(self) -> Result<(Parameters, Changes), ParametersError> {
        let (core, server) = self.declare_interfaces()?;
        let changes = Changes::new(server, Arc::clone(&core));
        Ok((Parameters::of_program(core), changes))
    }

    //= SM2-PRM-001
    fn declare_interfaces(
        self,
    ) -> Result<(Arc<Core>, Server<SetParameters, SetParametersResult>), ParametersError> {
        let claim = self.node.shared.claim_parameters();
        let claim = claim.ok_or(ParametersError::Again)?;
        let node = self.node.name().as_str();
        let from_environment = env::var_os(FILE_VARIABLE).filter(|it| !it.is_empty());
        let paths = from_environment.map(PathBuf::from).into_iter();
        let files = paths.chain(self.files).map(File::load);
        let files = files.collect::<Result<Vec<_>, _>>()?;
        let variable = |name: &str| env::var_os(name);
        let table = resolve(self.entries, node, &files, &variable, wall_time().0)?;

        let name = name(node);
        // No program waits for those who watch its parameters: keep-last, and no time to wait.
        let publisher = (self.node.publisher_builder(&name).latched(1))
            .publish_timeout(Duration::ZERO)
            .declare()?;
        let server = self.node.server_builder(&name);
        let server = server.max_len(TABLE_MAX as u64).declare()?;
        publisher.publish(&table)?;
        self.table.store(Arc::new(table));
        Ok((Arc::new(Core::new(self.table, publisher, claim)), server))
    }
}

/// A parameter of a [`ParametersBuilder`].
#[derive(Debug)]
#[must_use = "a parameter is not part of the node until add is called"]
pub struct ParameterBuilder<'a, T> {
    builder: &'a mut ParametersBuilder,
    entry: Entry,
    default: T,
}

impl<T: ParameterType> ParameterBuilder<'_, T> {
    /// Says what the parameter is for, and its unit: up to 1,024 bytes, which tools show.
    pub fn description(mut self, text: &str) -> Self {
        text.clone_into(&mut self.entry.description);
        self
    }

    /// Sets whether the parameter keeps the value that it has when the program starts; false by default.
    pub const fn read_only(mut self, read_only: bool) -> Self {
        self.entry.read_only = read_only;
        self
    }

    /// Adds the parameter, and returns its handle. Errors are those of [`declare`](ParametersBuilder::declare).
    pub fn add(self) -> Parameter<T> {
        let Self {
            builder,
            entry,
            default,
        } = self;
        let parameter = Parameter {
            table: Arc::clone(&builder.table),
            at: builder.entries.len(),
            name: entry.name.as_str().into(),
            default,
        };
        builder.entries.push(entry);
        parameter
    }
}

impl ParameterBuilder<'_, i64> {
    /// Sets the least and the greatest value.
    pub const fn range(self, values: std::ops::RangeInclusive<i64>) -> Self {
        self.range_in_steps(values, 0)
    }

    /// Sets the least and the greatest value, and the distance between two values, counted from the least one.
    pub const fn range_in_steps(
        mut self,
        values: std::ops::RangeInclusive<i64>,
        step: u64,
    ) -> Self {
        self.entry.range = Some(Range::Integer {
            from: *values.start(),
            to: *values.end(),
            step,
        });
        self
    }
}

impl ParameterBuilder<'_, f64> {
    /// Sets the least and the greatest value.
    pub const fn range(self, values: std::ops::RangeInclusive<f64>) -> Self {
        self.range_in_steps(values, 0.0)
    }

    /// Sets the least and the greatest value, and the distance between two values, counted from the least one.
    pub const fn range_in_steps(
        mut self,
        values: std::ops::RangeInclusive<f64>,
        step: f64,
    ) -> Self {
        self.entry.range = Some(Range::Double {
            from: *values.start(),
            to: *values.end(),
            step,
        });
        self
    }
}
