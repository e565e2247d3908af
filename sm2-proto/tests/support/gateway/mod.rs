//! Two decoders of what gateways send, and a comparison of both.

pub(crate) mod agreement;
pub(crate) mod json;
pub(crate) mod naive;
