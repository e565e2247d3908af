//! Declaring an interface.

use std::sync::{Arc, OnceLock};

use sm2_proto::link::MaxLen;
use sm2_proto::node;
use sm2_proto::{Contract, Refusal, TypeId};

use super::{Handle, until};
use crate::driver::{Control, NodeSets, NotDeclared, PoolLimit, SharedNode, State, WaitFailure};
use crate::schema::check_schema;
use crate::{DeclareError, Wait};

impl Handle {
    /// Declares an interface, and waits for the Manager's answer. The schema texts of its types are
    /// registered, for types that have one.
    pub(crate) fn declare(
        shared: &Arc<SharedNode>,
        contract: Contract,
        pool_limit: PoolLimit,
        max_len: MaxLen,
        schemas: impl IntoIterator<Item = (TypeId, Option<String>)>,
    ) -> Result<Self, DeclareError> {
        contract.check_qos()?;
        let name = contract.name().clone();
        let mut control = shared.lock_driven();
        for (data, text) in schemas {
            register_schema(&mut control, data, text, &shared.sets);
        }
        let declared = control.declare(
            contract.clone(),
            pool_limit,
            max_len,
            shared.control_side(),
            &shared.sets,
        );
        drop(control);
        let interface = match declared {
            Ok(interface) => interface,
            Err(NotDeclared::Session(error)) => return Err(refused_here(error, contract)),
            Err(NotDeclared::Sets(error)) => return Err(DeclareError::Io(error)),
        };
        // From here on, dropping the handle withdraws the interface at the Manager.
        let mut handle = Self {
            interface,
            shared: Arc::clone(shared),
            name: name.clone(),
            matched: 0,
            inline_max: 0,
            wait: Wait::Park,
            bell: OnceLock::new(),
            polled: OnceLock::new(),
            #[cfg(feature = "tokio")]
            cleared: Arc::default(),
        };
        let until = until(Some(shared.manager_timeout));
        let answer = shared.wait(until, |control| {
            match control.declared(handle.interface.id)? {
                State::Declaring => None,
                state => Some(state),
            }
        });
        let answer = answer.map_err(|failure| match failure {
            WaitFailure::Shutdown => DeclareError::Shutdown { name: name.clone() },
            WaitFailure::Io(error) => DeclareError::Io(error),
        });
        match answer? {
            Some(State::Live { matches }) => {
                handle.matched = matches as usize;
                Ok(handle)
            }
            Some(State::Refused(reason)) => Err(refused(reason, contract)),
            Some(State::Declaring) | None => Err(match shared.lock().away() {
                Some(end) => DeclareError::ManagerGone { name, end },
                None => DeclareError::TimedOut { name },
            }),
        }
    }
}

/// Converts a refusal of the Manager into an error.
fn refused(reason: Refusal, contract: Contract) -> DeclareError {
    let kind = contract.kind();
    let name = contract.name().clone();
    match (reason, contract) {
        (
            Refusal::TopicType { theirs },
            Contract::Publisher { data: ours, .. }
            | Contract::Subscriber {
                data: Some(ours), ..
            },
        ) => DeclareError::TypeMismatch {
            topic: name,
            kind,
            ours,
            theirs,
        },
        (
            Refusal::ServiceType {
                request: theirs,
                reply: their_reply,
            },
            Contract::Server { request, reply, .. }
            | Contract::Client {
                types: Some((request, reply)),
                ..
            },
        ) => DeclareError::ServiceMismatch {
            service: name,
            kind,
            ours: Box::new((request, reply)),
            theirs: Box::new((theirs, their_reply)),
        },
        (Refusal::Quota { quota, limit }, _) => DeclareError::Quota { name, quota, limit },
        (reason, _) => DeclareError::Refused { name, reason },
    }
}

/// Converts a refusal of the session's machine into an error. All conditions that it checks were checked
/// before.
fn refused_here(error: node::Error, contract: Contract) -> DeclareError {
    debug_assert!(false, "{error}");
    DeclareError::ManagerGone {
        name: contract.name().clone(),
        end: node::End::Eof,
    }
}

/// Registers a type's text for tools. A text that does not fit the type's hash (a manual implementation) is
/// not registered, because the Manager would treat it as a violation.
fn register_schema(control: &mut Control, data: TypeId, text: Option<String>, sets: &NodeSets) {
    let Some(text) = text else { return };
    match check_schema(&data, &text) {
        Ok(()) => control.register_schema(data, text, sets),
        Err(error) => {
            tracing::warn!(%error, "tools cannot decode this type: its schema is not registered")
        }
    }
}
