//! Requests to set parameters, which the program accepts or refuses.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use sm2_proto::Name;

use super::core::{Core, Parameter, SetRequest, Snapshot};
use super::table::{Assignment, SetParameters, SetParametersResult};
use super::value::ParameterType;
use crate::driver::{Condition, SharedInterface};
use crate::wait_set::Source;
use crate::{RecvError, Server};

/// The reason for a client whose change the program dropped.
const DROPPED: &str = "the program dropped the change without an answer";

/// The changes that other nodes ask for, one after the other: a source of a [`WaitSet`](crate::WaitSet) and of an
/// [executor](crate::executor::Group::on_change).
///
/// Each [`Change`] has values of the right types, within the ranges, for parameters that are not read-only: the library
/// refuses all others. While the program does not ask for the next change, nothing changes: requests wait, 64 of each
/// client, until the time limit of their client has passed. The values can be read all the time.
#[derive(Debug)]
pub struct Changes {
    server: Server<SetParameters, SetParametersResult>,
    core: Arc<Core>,
}

impl Changes {
    pub(super) const fn new(
        server: Server<SetParameters, SetParametersResult>,
        core: Arc<Core>,
    ) -> Self {
        Self { server, core }
    }

    /// Waits for the next change, without a time limit.
    ///
    /// # Errors
    ///
    /// As [`Server::recv`]; not [`RecvError::Payload`].
    pub fn next(&self) -> Result<Change, RecvError> {
        loop {
            if let Some(change) = self.checked(self.server.recv().map(Some))? {
                return Ok(change);
            }
        }
    }

    /// Waits for the next change, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// As [`next`](Self::next).
    pub fn next_timeout(&self, timeout: Duration) -> Result<Option<Change>, RecvError> {
        let until = crate::now().after(timeout);
        loop {
            let left = until.since(crate::now());
            let change = self.checked(self.server.recv_timeout(left))?;
            if change.is_some() || crate::now() >= until {
                return Ok(change);
            }
        }
    }

    /// Returns the next change, if there is one.
    ///
    /// # Errors
    ///
    /// As [`next`](Self::next).
    pub fn try_next(&self) -> Result<Option<Change>, RecvError> {
        loop {
            let request = self.server.try_recv();
            let is_last = matches!(request, Ok(None));
            let change = self.checked(request)?;
            if is_last || change.is_some() {
                return Ok(change);
            }
        }
    }

    /// Refuses a request that breaks the rules of the parameters.
    //= SM2-PRM-003
    fn checked(
        &self,
        received: Result<Option<SetRequest>, RecvError>,
    ) -> Result<Option<Change>, RecvError> {
        let request = match received {
            Ok(Some(request)) => request,
            Ok(None) => return Ok(None),
            // The server has told the client.
            Err(RecvError::Payload { .. }) => return Ok(None),
            Err(error) => return Err(error),
        };
        let snapshot = self.core.snapshot();
        match snapshot.table.set(&request.parameters, 0) {
            Err(refusal) => {
                self.core.refuse(request, &refusal);
                Ok(None)
            }
            Ok(_) => Ok(Some(Change {
                client: request.client().clone(),
                request: Some(request),
                snapshot,
                core: Arc::clone(&self.core),
            })),
        }
    }
}

impl Source for Changes {
    fn interface(&self) -> &Arc<SharedInterface> {
        self.server.interface()
    }

    fn condition(&self) -> Condition {
        self.server.condition()
    }
}

/// A request of another node to set parameters, all of them or none. The client waits for [`accept`](Self::accept) or
/// [`refuse`](Self::refuse); dropping the change refuses it.
pub struct Change {
    client: Name,
    /// `None` once it is answered.
    request: Option<SetRequest>,
    snapshot: Snapshot,
    core: Arc<Core>,
}

impl Change {
    /// The value that a parameter has after the change: the proposed one, or else the present one.
    #[must_use]
    pub fn get<T: ParameterType>(&self, parameter: &Parameter<T>) -> T {
        let proposed = self.proposed(parameter);
        proposed
            .unwrap_or_else(|| self.snapshot.get(parameter))
            .clone()
    }

    /// The value that is proposed for a parameter, if the change has one.
    #[must_use]
    pub fn proposed<T: ParameterType>(&self, parameter: &Parameter<T>) -> Option<&T> {
        let mut assignments = self.assignments().iter();
        let assignment = assignments.find(|it| it.name == parameter.name())?;
        T::of_value(&assignment.value)
    }

    /// The proposed values.
    #[must_use]
    pub fn assignments(&self) -> &[Assignment] {
        (self.request.as_ref()).map_or(&[], |it| it.parameters.as_slice())
    }

    /// The name of the client's node.
    #[must_use]
    pub const fn client(&self) -> &Name {
        &self.client
    }

    /// Sets the values, and tells the client. Returns whether they are set: handles of the parameters have them then.
    ///
    /// Nothing is set if the client has cancelled the request, is gone, or has waited for as long as it wanted; or if
    /// the values cannot be published, for lack of memory, which the client is told.
    pub fn accept(mut self) -> bool {
        (self.request.take()).is_some_and(|request| self.core.accept(request))
    }

    /// Changes nothing, and tells the client the reason; 1,024 bytes of it are kept.
    pub fn refuse(mut self, reason: impl fmt::Display) {
        if let Some(request) = self.request.take() {
            self.core.refuse(request, &reason);
        }
    }
}

impl Drop for Change {
    fn drop(&mut self) {
        if let Some(request) = self.request.take() {
            self.core.refuse(request, &DROPPED);
        }
    }
}

impl fmt::Debug for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Change")
            .field("client", &self.client())
            .field("assignments", &self.assignments())
            .finish_non_exhaustive()
    }
}
