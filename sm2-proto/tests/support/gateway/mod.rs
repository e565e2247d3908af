//! What gateways send, twice decoded.

pub(crate) mod agreement;
pub(crate) mod naive;
pub(crate) mod words;
