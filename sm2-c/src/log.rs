//! The library's log.

use tracing_subscriber::filter::LevelFilter;

use crate::status::{Failure, Status, guard};

/// Writes the library's log to the standard error, from now on and in all threads: the reasons why links and sessions
/// ended, and what SM2 does. Without this call there is no log. `level` is 1 for errors, 2 for warnings as well, 3 for
/// information, 4 and 5 for details.
///
/// Errors: `SM2_MISUSE` for another level, and for a second call.
///
/// Threads: any.
#[unsafe(no_mangle)]
pub extern "C" fn sm2_log_to_stderr(level: u32) -> Status {
    guard(|| {
        let level = match level {
            1 => LevelFilter::ERROR,
            2 => LevelFilter::WARN,
            3 => LevelFilter::INFO,
            4 => LevelFilter::DEBUG,
            5 => LevelFilter::TRACE,
            _ => {
                return Err(Failure::misuse(format!(
                    "{level} is not a level: pass 1 to 5"
                )));
            }
        };
        let log = tracing_subscriber::fmt().with_max_level(level);
        let started = log.with_writer(std::io::stderr).try_init();
        started.map_err(|_| Failure::misuse("the log was started before"))
    })
}
