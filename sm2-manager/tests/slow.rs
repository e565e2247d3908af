//! The tests of the Manager that wait for a time limit of the product.

mod common;

mod lock_timeout;
