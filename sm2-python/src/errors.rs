//! The exceptions of the package. Each has the text of the error of `sm2-node`.

use std::fmt::Display;

use pyo3::PyErr;
use pyo3::create_exception;
use pyo3::exceptions::PyException;

create_exception!(
    sm2,
    Error,
    PyException,
    "The base of all exceptions of SM2."
);
create_exception!(
    sm2,
    ConnectError,
    Error,
    "A node could not connect to its Manager."
);
create_exception!(
    sm2,
    DeclareError,
    Error,
    "A publisher, subscriber, server or client was not declared."
);
create_exception!(
    sm2,
    TypeMismatchError,
    DeclareError,
    "The topic or service has another type. The text shows both, with their schemas if they are known."
);
create_exception!(
    sm2,
    SchemaError,
    Error,
    "A type has no schema, or its schema is malformed."
);
create_exception!(sm2, PublishError, Error, "A message was not published.");
create_exception!(
    sm2,
    LoanError,
    PublishError,
    "A loan was not published, because something else still refers to its memory."
);
create_exception!(sm2, RecvError, Error, "No message was received.");
create_exception!(
    sm2,
    BorrowLimitError,
    RecvError,
    "The program holds as many samples as max_borrowed allows. The text says how many views hold samples of the topic."
);
create_exception!(sm2, WaitError, Error, "A wait ended without its result.");
create_exception!(sm2, CallError, Error, "A call has no reply.");
create_exception!(sm2, ReplyError, Error, "A reply was not sent.");
create_exception!(
    sm2,
    QueryError,
    Error,
    "A question to the Manager has no answer."
);
create_exception!(sm2, ClosedError, Error, "The object is closed.");
create_exception!(
    sm2,
    ForkError,
    Error,
    "The object belongs to the process that forked this one."
);

/// Makes the exception `E` from an error of `sm2-node`.
pub(crate) fn raise<E: Display>(exception: fn(String) -> PyErr) -> impl Fn(E) -> PyErr {
    move |error| exception(error.to_string())
}
