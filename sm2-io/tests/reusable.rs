//! A value that is used again: the owner and the loan, in either order.

use std::sync::Arc;

use sm2_io::Reusable;

#[test]
fn a_value_is_lent_to_one_at_a_time() {
    let mut number = Reusable::new(1);
    let lent = number.lend(|it| *it += 1).unwrap();
    assert!(number.lend(|_| panic!("it is lent")).is_none());
    assert_eq!(*lent, 2);
    drop(lent);
    assert_eq!(*number.lend(|it| *it += 1).unwrap(), 3);
}

#[test]
fn the_last_end_drops_the_value() {
    let value = Arc::new(());
    let lendable = || Reusable::new(Arc::clone(&value));
    drop(lendable());
    assert_eq!(Arc::strong_count(&value), 1);

    let mut owner = lendable();
    drop(owner.lend(|_| ()));
    assert_eq!(Arc::strong_count(&value), 2);
    let lent = owner.lend(|_| ()).unwrap();
    drop(owner);
    assert_eq!(Arc::strong_count(&lent), 2);
    drop(lent);
    assert_eq!(Arc::strong_count(&value), 1);
}
