//! What gateways take from others, under operations that bytes decide: the bodies of the fuzz
//! targets `gateway_session` and `gateway_discovery`, and of unit tests.

mod discovery;
mod oracle;
mod session;

pub(crate) use self::{discovery::discovery, session::session};

#[cfg(test)]
mod tests {
    use super::{discovery, session};
    use proptest::{collection::vec, prelude::*};

    proptest! {
        #![proptest_config(ProptestConfig { cases: 1_000, failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn bytes_decide_a_session(data in vec(any::<u8>(), 0..300)) {
            session(&data);
        }

        /// No byte that changes much, so that runs get long.
        #[test]
        fn calm_bytes_decide_a_session(data in vec(0_u8..0xfc, 0..900)) {
            session(&data);
        }

        #[test]
        fn bytes_decide_whom_to_dial(data in vec(any::<u8>(), 0..900)) {
            discovery(&data);
        }
    }
}
