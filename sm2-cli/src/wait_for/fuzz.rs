//! What a fuzz target checks of the expressions.

use sm2_proto::domain::Domain;

use super::expression::Expression;

/// One that is read can be looked up in a domain, which has nothing here; else it is said in
/// one line what is wrong.
pub(crate) fn expression(text: &str) {
    match Expression::parse(text) {
        Ok(expression) => {
            let domain = Domain::default();
            let seen = expression.seen(&domain);
            assert_eq!(seen.met, expression.is_met(&domain));
            assert!(expression.hint(&domain).is_empty());
        }
        Err(error) => assert!(!error.is_empty() && !error.contains('\n'), "{error:?}"),
    }
}
