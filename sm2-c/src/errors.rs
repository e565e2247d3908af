//! The code of each error of sm2-node. The enumerations may grow: an error without a code is `SM2_UNKNOWN`.

use std::io;

use sm2_node::domain::QueryError;
use sm2_node::schema::SchemaError;
use sm2_node::{
    CallError, ConnectError, DeclareError, NameError, PublishError, RecvError, ReplyError,
    StoreError, WaitError,
};
use sm2_proto::Refusal;
use sm2_ros_idl::{FolderError, SetError};

use crate::status::{Failure, Status};

/// Implements the conversion from errors that have a code.
macro_rules! failure_from {
    ($($error:ty: $status:expr, $cause:expr;)*) => {
        $(
            impl From<$error> for Failure {
                fn from(error: $error) -> Self {
                    let status: fn(&$error) -> Status = $status;
                    let cause: fn(&$error) -> Option<&io::Error> = $cause;
                    Self::new(status(&error), &error, cause(&error))
                }
            }
        )*
    };
}

failure_from! {
    io::Error: |_| Status::IO, |it| Some(it);
    NameError: |_| Status::BAD_NAME, |_| None;
    SchemaError: |_| Status::BAD_SCHEMA, |_| None;
    sm2_proto::schema::ParseError: |_| Status::BAD_SCHEMA, |_| None;
    sm2_ros_idl::NameError: |_| Status::BAD_NAME, |_| None;
    SetError: |_| Status::BAD_SCHEMA, |_| None;
    FolderError: folder, unreadable;
    ConnectError: connect, ConnectError::os_error;
    DeclareError: declare, DeclareError::os_error;
    WaitError: wait, WaitError::os_error;
    QueryError: query, QueryError::os_error;
    StoreError: store, StoreError::os_error;
    PublishError: publish, PublishError::os_error;
    RecvError: recv, RecvError::os_error;
    CallError: call, CallError::os_error;
    ReplyError: reply, ReplyError::os_error;
}

fn folder(error: &FolderError) -> Status {
    match error {
        FolderError::Io { .. } => Status::IO,
        FolderError::Definition { .. } | FolderError::Name { .. } => Status::BAD_SCHEMA,
    }
}

const fn unreadable(error: &FolderError) -> Option<&io::Error> {
    match error {
        FolderError::Io { error, .. } => Some(error),
        FolderError::Definition { .. } | FolderError::Name { .. } => None,
    }
}

fn connect(error: &ConnectError) -> Status {
    match error {
        ConnectError::Name { .. } | ConnectError::DomainSocket(_) => Status::BAD_NAME,
        ConnectError::NoManager { .. } | ConnectError::TimedOut { .. } | ConnectError::Ended(_) => {
            Status::NO_MANAGER
        }
        ConnectError::NameTaken { .. } => Status::NAME_TAKEN,
        ConnectError::Refused(refusal) => refused(refusal),
        ConnectError::Shutdown => Status::SHUTDOWN,
        ConnectError::Manager(_) | ConnectError::BackgroundThread(_) | ConnectError::Io { .. } => {
            Status::IO
        }
        _ => Status::UNKNOWN,
    }
}

fn declare(error: &DeclareError) -> Status {
    match error {
        DeclareError::Name { .. } => Status::BAD_NAME,
        DeclareError::Qos(_)
        | DeclareError::NoMaxLen { .. }
        | DeclareError::ReservedSealed { .. }
        | DeclareError::ReserveTooMuch { .. } => Status::BAD_QOS,
        DeclareError::TypeMismatch { .. } | DeclareError::ServiceMismatch { .. } => {
            Status::TYPE_MISMATCH
        }
        DeclareError::Quota { .. } => Status::QUOTA,
        DeclareError::Refused { reason, .. } => refused(reason),
        DeclareError::TimedOut { .. } | DeclareError::ManagerGone { .. } => Status::NO_MANAGER,
        DeclareError::Shutdown { .. } => Status::SHUTDOWN,
        DeclareError::Reserve { .. } | DeclareError::Lock { .. } | DeclareError::Io(_) => {
            Status::IO
        }
        _ => Status::UNKNOWN,
    }
}

const fn refused(refusal: &Refusal) -> Status {
    match refusal {
        Refusal::NameTaken => Status::NAME_TAKEN,
        Refusal::TopicType { .. } | Refusal::ServiceType { .. } => Status::TYPE_MISMATCH,
        Refusal::Quota { .. } => Status::QUOTA,
        _ => Status::REFUSED,
    }
}

fn wait(error: &WaitError) -> Status {
    match error {
        WaitError::TimedOut { .. } => Status::TIMED_OUT,
        WaitError::ManagerGone { .. } | WaitError::NoManager { .. } => Status::NO_MANAGER,
        WaitError::Shutdown => Status::SHUTDOWN,
        WaitError::Io(_) => Status::IO,
        _ => Status::UNKNOWN,
    }
}

fn query(error: &QueryError) -> Status {
    match error {
        QueryError::ManagerGone(_) | QueryError::TimedOut => Status::NO_MANAGER,
        QueryError::Shutdown => Status::SHUTDOWN,
        QueryError::Io(_) => Status::IO,
        _ => Status::UNKNOWN,
    }
}

fn store(error: &StoreError) -> Status {
    match error {
        StoreError::TooLong { .. } => Status::TOO_LONG,
        StoreError::PoolFull { .. } => Status::POOL_FULL,
        StoreError::Io(_) => Status::IO,
        _ => Status::UNKNOWN,
    }
}

fn publish(error: &PublishError) -> Status {
    match error {
        PublishError::Store(error) => store(error),
        PublishError::DeadlineExceeded { .. } => Status::MISSED,
        PublishError::TooLong { .. } => Status::TOO_LONG,
        PublishError::Shutdown => Status::SHUTDOWN,
        PublishError::Io(_) => Status::IO,
        _ => Status::UNKNOWN,
    }
}

fn recv(error: &RecvError) -> Status {
    match error {
        RecvError::TooManyBorrowed { .. } => Status::BORROW_LIMIT,
        RecvError::Payload { .. } | RecvError::Map { .. } => Status::UNREADABLE,
        RecvError::Shutdown => Status::SHUTDOWN,
        RecvError::Io(_) => Status::IO,
        _ => Status::UNKNOWN,
    }
}

fn call(error: &CallError) -> Status {
    match error {
        CallError::NoServer { .. } => Status::NO_SERVER,
        CallError::ServerGone { .. } => Status::SERVER_GONE,
        CallError::DeadlineExceeded { .. } => Status::DEADLINE_EXCEEDED,
        CallError::Cancelled { .. } => Status::CANCELLED,
        CallError::Failed { .. } => Status::CALL_FAILED,
        CallError::TooManyCalls { .. } => Status::BORROW_LIMIT,
        CallError::TooLong { .. } => Status::TOO_LONG,
        CallError::Store(error) => store(error),
        CallError::Payload { .. } | CallError::Map { .. } => Status::UNREADABLE,
        CallError::Shutdown { .. } => Status::SHUTDOWN,
        CallError::Io { .. } => Status::IO,
        _ => Status::UNKNOWN,
    }
}

fn reply(error: &ReplyError) -> Status {
    match error {
        ReplyError::Store(error) => store(error),
        ReplyError::TooLong { .. } => Status::TOO_LONG,
        ReplyError::ClientGone { .. } => Status::CLIENT_GONE,
        _ => Status::UNKNOWN,
    }
}
