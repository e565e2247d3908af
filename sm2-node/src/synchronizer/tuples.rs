//! Tuples of inputs, and the tuples of messages that come of them.

use super::input::{AnySlot, IntoInput, Slot};
use crate::{DeclareError, Message, Sample};

/// A tuple of two to eight inputs, each a [`SubscriberBuilder`](crate::SubscriberBuilder) or an
/// [`Input`](super::Input). Only tuples of this crate implement it.
pub trait InputTuple {
    /// The tuple of a [`Sample`] of each input.
    type Set: Send + 'static;

    /// Declares the subscribers. Each may hold at least `held` messages of each publisher.
    #[doc(hidden)]
    fn declare(self, held: u16) -> Result<Slots<Self::Set>, DeclareError>;
}

/// The declared inputs of a synchronizer with the sets `S`.
pub struct Slots<S>(pub(super) Box<dyn AnySlots<S>>);

/// The declared inputs of a synchronizer, whatever their number.
pub(super) trait AnySlots<S>: Send {
    /// The input with this number, counted from 0.
    fn slot(&self, input: usize) -> Option<&dyn AnySlot>;

    fn slot_mut(&mut self, input: usize) -> Option<&mut dyn AnySlot>;

    /// Takes the oldest message of each input.
    fn take_set(&mut self) -> Option<S>;
}

impl<S> Slots<S> {
    /// All inputs, in order.
    pub(super) fn iter(&self) -> impl Iterator<Item = &dyn AnySlot> {
        (0..).map_while(|input| self.0.slot(input))
    }
}

macro_rules! input_tuples {
    ($(($($input:ident $at:tt),+))+) => {
        $(
            impl<$($input: IntoInput),+> InputTuple for ($($input,)+) {
                type Set = ($(Sample<$input::Message>,)+);

                fn declare(self, held: u16) -> Result<Slots<Self::Set>, DeclareError> {
                    let slots = ($(self.$at.into_input().declare(held)?,)+);
                    Ok(Slots(Box::new(slots)))
                }
            }

            impl<$($input: Message + ?Sized),+> AnySlots<($(Sample<$input>,)+)>
                for ($(Slot<$input>,)+)
            {
                fn slot(&self, input: usize) -> Option<&dyn AnySlot> {
                    match input {
                        $($at => Some(&self.$at),)+
                        _ => None,
                    }
                }

                fn slot_mut(&mut self, input: usize) -> Option<&mut dyn AnySlot> {
                    match input {
                        $($at => Some(&mut self.$at),)+
                        _ => None,
                    }
                }

                fn take_set(&mut self) -> Option<($(Sample<$input>,)+)> {
                    Some(($(self.$at.held.pop_front()?,)+))
                }
            }
        )+
    };
}

input_tuples! {
    (A 0, B 1)
    (A 0, B 1, C 2)
    (A 0, B 1, C 2, D 3)
    (A 0, B 1, C 2, D 3, E 4)
    (A 0, B 1, C 2, D 3, E 4, F 5)
    (A 0, B 1, C 2, D 3, E 4, F 5, G 6)
    (A 0, B 1, C 2, D 3, E 4, F 5, G 6, H 7)
}
