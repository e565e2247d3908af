//! Messages that are written in place.

use std::ffi::c_void;
use std::mem::MaybeUninit;
use std::sync::Arc;

use crate::arguments::given;
use crate::publisher::Publisher;
use crate::report::PublishResult;
use crate::status::{Failure, Status, guard, guard_drop};

/// A message that is written in the memory that its subscribers read: see `sm2_publisher_loan()`.
#[derive(Debug)]
pub struct Loan {
    /// Refers to `_publisher`, and is dropped first. `None` once the loan is spent.
    loan: Option<sm2_node::Loan<'static, [u8]>>,
    _publisher: Arc<sm2_node::Publisher<[u8]>>,
}

// A program may pass a loan to another thread, as the header says.
const _: fn() = || {
    fn can_be_sent<T: Send>() {}
    can_be_sent::<Loan>();
};

impl Loan {
    fn new(publisher: &Publisher, len: usize) -> Result<Self, Failure> {
        let publisher = Arc::clone(&publisher.0);
        let loan = publisher.loan_slice(len)?;
        // SAFETY: only the lifetime changes. The loan refers to the publisher in the `Arc`, which does not move and
        // lives at least as long as this struct, which drops the loan first and never gives it away.
        let loan = unsafe {
            std::mem::transmute::<sm2_node::Loan<'_, [u8]>, sm2_node::Loan<'static, [u8]>>(loan)
        };
        Ok(Self {
            loan: Some(loan),
            _publisher: publisher,
        })
    }

    fn spent() -> Failure {
        Failure::misuse("the loan is spent: it was published; take a new one")
    }
}

/// Allocates memory for one message of `len` bytes, which the program writes in place. The memory is aligned to 64
/// bytes. Its content is unspecified: zeroes, or the bytes of an earlier message.
///
/// `*loan` is NULL, or a loan of an earlier call. In the second case its memory is given back first, and the handle is
/// used again, so that a loop does not allocate. After an error it stays spent.
///
/// Errors: `SM2_TOO_LONG`, `SM2_POOL_FULL`, `SM2_IO`, `SM2_MISUSE`.
///
/// Threads: any, at the same time with other loans.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_publisher_loan(
    publisher: Option<&Publisher>,
    len: usize,
    loan: Option<&mut Option<Box<Loan>>>,
) -> Status {
    guard(|| {
        let place = given(loan, "loan")?;
        let publisher = given(publisher, "publisher")?;
        if let Some(earlier) = place {
            earlier.loan = None;
        }
        let loan = Loan::new(publisher, len)?;
        match place {
            Some(earlier) => **earlier = loan,
            None => *place = Some(Box::new(loan)),
        }
        Ok(())
    })
}

/// Stores the memory of a loan in `data`, and its length in `len` (which may be NULL). The program may write to the
/// memory until the loan is published or freed.
///
/// Errors: `SM2_MISUSE`, also if the loan is spent.
///
/// Threads: one at a time for each loan.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_loan_data(
    loan: Option<&mut Loan>,
    data: Option<&mut MaybeUninit<*mut c_void>>,
    len: Option<&mut MaybeUninit<usize>>,
) -> Status {
    guard(|| {
        let loan = given(loan, "loan")?;
        let bytes = loan.loan.as_mut().ok_or_else(Loan::spent)?;
        given(data, "data")?.write(bytes.as_mut_ptr().cast());
        if let Some(len) = len {
            len.write(bytes.len());
        }
        Ok(())
    })
}

/// Sends the message of a loan to all subscribers without a copy. The loan is spent then, also after an error: its
/// memory is not the program's any more. `result` may be NULL. The handle must still be freed, or used again.
///
/// Waits as `sm2_publisher_publish()` does.
///
/// Errors: `SM2_SHUTDOWN`, `SM2_IO`, `SM2_POOL_FULL`, `SM2_MISUSE`, also if the loan is spent.
///
/// Threads: one at a time for each loan; not necessarily the one that took the loan.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_loan_publish(loan: Option<&mut Loan>, result: *mut PublishResult) -> Status {
    guard(|| {
        let loan = given(loan, "loan")?;
        PublishResult::of(result, || {
            let loan = loan.loan.take().ok_or_else(Loan::spent)?;
            Ok(loan.publish()?)
        })
    })
}

/// Frees a loan, and gives back its memory if it was not published; NULL is ignored.
///
/// Threads: any, but no other call may use this handle at the same time or later.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_loan_free(loan: Option<Box<Loan>>) {
    guard_drop(loan);
}
