//! The limits of `sm2 up`.

use std::time::Duration;

/// The delay before the first restart of a program. Each further one is twice as long.
pub(super) const FIRST_DELAY: Duration = Duration::from_millis(500);

/// The longest delay before a restart.
pub(super) const LONGEST_DELAY: Duration = Duration::from_secs(10);

/// How often a program is started again, unless its `max_restarts` says otherwise.
pub(super) const RESTARTS: u32 = 5;

/// A program that ran this long gets the first delay and all restarts again.
pub(super) const STABLE: Duration = Duration::from_secs(60);

/// The time from SIGTERM to SIGKILL, unless `stop_timeout` of the file says otherwise.
pub(super) const STOP_TIMEOUT: Duration = Duration::from_secs(5);

/// The time that the kernel has to remove a process group after SIGKILL.
pub(super) const KILL_TIMEOUT: Duration = Duration::from_secs(5);

/// A signal that follows the first one within this time is the same one, passed on twice.
pub(super) const SECOND_SIGNAL: Duration = Duration::from_millis(500);

/// The time that a Manager has until it serves, from its start on.
pub(super) const MANAGER_TIMEOUT: Duration = Duration::from_secs(30);

/// How often the Manager that was started is tried.
pub(super) const MANAGER_STEP: Duration = Duration::from_millis(50);

/// The time until a program that waits is reported once more. Each further time is twice as long.
pub(super) const FIRST_REMINDER: Duration = Duration::from_secs(10);

/// The longest time between two reports of a program that waits.
pub(super) const LONGEST_REMINDER: Duration = Duration::from_secs(300);

/// The time after which a failed question about the domain is repeated.
pub(super) const QUESTION_RETRY: Duration = Duration::from_secs(1);

/// A line of a log that is longer is cut into lines of this length.
pub(super) const LINE_MAX_BYTES: usize = 4_096;

/// The bytes that are read of one log before the others have their turn.
pub(super) const READ_MAX_BYTES: usize = 65_536;

/// The most that a pipe holds by default.
pub(super) const PIPE_BYTES: usize = 1_048_576;

/// The lines that wait for a terminal or a reader that is slow. Further ones are dropped and counted.
pub(super) const QUEUED_LINES: usize = 2_048;

/// The time that the last lines may take.
pub(super) const FLUSH_TIMEOUT: Duration = Duration::from_secs(2);

/// How often the process groups are looked at after SIGTERM, once `sm2 up` itself is gone.
pub(super) const GUARD_STEP: Duration = Duration::from_millis(20);
