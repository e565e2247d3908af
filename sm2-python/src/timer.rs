//! Ticks at regular times.

use std::sync::{Mutex, MutexGuard, PoisonError};

use pyo3::prelude::*;
use sm2_node::MissedTicks;

use crate::options::Seconds;

/// A schedule of ticks, which never drifts.
#[pyclass(frozen, module = "sm2._native")]
pub(crate) struct Timer {
    inner: Mutex<sm2_node::Timer>,
}

/// A tick of a timer.
#[pyclass(frozen, get_all, eq, module = "sm2")]
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) struct Tick {
    /// The number of the tick, from 1.
    number: u64,
    /// The time when it was due, in nanoseconds of the monotonic clock.
    due_ns: u64,
    /// How many earlier ticks were skipped since the last one that was reported.
    missed: u64,
}

#[pymethods]
impl Tick {
    fn __repr__(&self) -> String {
        let Self {
            number,
            due_ns,
            missed,
        } = self;
        format!("Tick(number={number}, due_ns={due_ns}, missed={missed})")
    }
}

impl Timer {
    fn new(timer: sm2_node::Timer, burst: bool) -> Self {
        let missed = if burst {
            MissedTicks::Burst
        } else {
            MissedTicks::Skip
        };
        Self {
            inner: Mutex::new(timer.missed_ticks(missed)),
        }
    }

    fn lock(&self) -> MutexGuard<'_, sm2_node::Timer> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Timer {
    #[staticmethod]
    fn every(period: Seconds, burst: bool) -> Self {
        Self::new(sm2_node::Timer::every(period.0), burst)
    }

    #[staticmethod]
    fn hz(frequency: u32, burst: bool) -> Self {
        Self::new(sm2_node::Timer::hz(frequency), burst)
    }

    #[staticmethod]
    fn once(delay: Seconds) -> Self {
        Self::new(sm2_node::Timer::once(delay.0), false)
    }

    /// The time of the next tick, in nanoseconds of the monotonic clock.
    #[getter]
    fn deadline_ns(&self) -> Option<u64> {
        self.lock().deadline().map(|it| it.0)
    }

    /// The tick that is due, if one is.
    fn take(&self) -> Option<Tick> {
        let tick = self.lock().handle(sm2_node::now())?;
        Some(Tick {
            number: tick.number,
            due_ns: tick.due.0,
            missed: tick.missed,
        })
    }
}
