//! The bodies of the fuzz targets `gateway_session` and `gateway_discovery`, and of unit tests. The
//! input bytes choose the operations.

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

        /// Without the bytes that choose rare operations, so that sessions last longer.
        #[test]
        fn bytes_of_common_operations_decide_a_session(data in vec(0_u8..0xfc, 0..900)) {
            session(&data);
        }

        #[test]
        fn bytes_decide_whom_to_dial(data in vec(any::<u8>(), 0..900)) {
            discovery(&data);
        }
    }
}
