//! The explanations of a domain.

#[path = "../../../sm2-proto/tests/support/cases.rs"]
mod cases;
#[path = "../../../sm2-proto/tests/support/contracts.rs"]
mod contracts;
mod difference;
#[path = "../../../sm2-proto/tests/support/items.rs"]
mod items;
mod near;
mod usage;
mod why;
