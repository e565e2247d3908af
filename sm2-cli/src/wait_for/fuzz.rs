//! The body of a fuzz target: the expressions of `sm2 wait`.

use sm2_proto::domain::Domain;

use super::expression::Expression;

/// An expression that can be read can be evaluated in an empty domain. The error of any other text is one
/// line.
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
