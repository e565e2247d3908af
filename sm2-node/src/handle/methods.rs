//! The methods that publishers, subscribers, servers and clients share.

/// Implements the shared methods for a type that has `fn handle(&self) -> &Handle`.
macro_rules! interface_methods {
    (
        $type:ident<$($parameter:ident),+>,
        $name:ident: $name_doc:literal,
        $counterparts:literal: $wait_for:ident, $wait_for_timeout:ident $(,)?
    ) => {
        impl<$($parameter: $crate::Message + ?Sized),+> $type<$($parameter),+> {
            #[doc = $name_doc]
            #[must_use]
            pub fn $name(&self) -> &sm2_proto::Name {
                &self.handle().name
            }

            #[doc = concat!("How many ", $counterparts, " the Manager linked at once when it granted this interface")]
            /// (SM2-IFC-002). Further links may have waited, and a link without descriptors is counted although it
            /// never comes.
            #[must_use]
            pub fn matched(&self) -> usize {
                self.handle().matched()
            }

            #[doc = concat!("Waits until at least `count` ", $counterparts, " are linked, without a time limit.")]
            ///
            /// # Errors
            ///
            /// [`WaitError::Io`](crate::WaitError::Io).
            pub fn $wait_for(&self, count: usize) -> Result<(), $crate::WaitError> {
                self.handle().wait_open(count, None)
            }

            #[doc = concat!("Waits until at least `count` ", $counterparts, " are linked, for at most `timeout`.")]
            ///
            /// # Errors
            ///
            /// See [`WaitError`](crate::WaitError).
            pub fn $wait_for_timeout(
                &self,
                count: usize,
                timeout: std::time::Duration,
            ) -> Result<(), $crate::WaitError> {
                self.handle().wait_open(count, Some(timeout))
            }

            /// True if the current Manager has granted this declaration. False without a Manager,
            /// and if a Manager that took over refused it or another access policy denies it, which is
            /// logged with the reason (SM2-RES-010, SM2-ACC-013). Open links remain, unless the policy
            /// denies them.
            #[must_use]
            pub fn is_registered(&self) -> bool {
                self.handle().is_registered()
            }

            /// Explains why this interface has no links: returns the interfaces that come closest to one
            #[doc = concat!("of its ", $counterparts, ", with the reasons why they do not match.")]
            ///
            /// # Errors
            ///
            /// See [`QueryError`](crate::domain::QueryError).
            pub fn why(&self) -> Result<Vec<$crate::explain::Near>, $crate::error::QueryError> {
                self.handle().why()
            }

            /// Returns its [events](crate::Event): links that open and end, and losses. They are collected from the
            /// first call on.
            pub fn events(&self) -> $crate::Events {
                $crate::Events::new(&self.handle().interface)
            }

            /// Returns the state of its links: the last 64 that ended, then those that exist. A link counts
            /// sent messages in `counters`, and received messages in `received`.
            pub fn links(&self) -> Vec<$crate::driver::LinkStatus> {
                self.handle().links()
            }
        }

        impl<$($parameter: $crate::Message + ?Sized),+> std::os::fd::AsFd for $type<$($parameter),+> {
            fn as_fd(&self) -> std::os::fd::BorrowedFd<'_> {
                self.handle().descriptor()
            }
        }
    };
}

pub(crate) use interface_methods;
