//! The warnings of this process that accuse another process of a violation.

use std::{
    fmt::Debug,
    mem,
    sync::{Mutex, Once, PoisonError},
};

use tracing::{
    Event, Level, Metadata, Subscriber,
    field::{Field, Visit},
    span::{Attributes, Id, Record},
};

static ACCUSATIONS: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// Takes the accusations since the last call.
pub(crate) fn accusations() -> Vec<String> {
    mem::take(&mut *ACCUSATIONS.lock().unwrap_or_else(PoisonError::into_inner))
}

/// Collects accusations from now on.
pub(crate) fn collect() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| tracing::subscriber::set_global_default(Collector).unwrap());
}

struct Collector;

impl Subscriber for Collector {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        *metadata.level() <= Level::WARN
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, event: &Event<'_>) {
        let mut fields = Fields::default();
        event.record(&mut fields);
        if fields.accuses {
            let mut all = ACCUSATIONS.lock().unwrap_or_else(PoisonError::into_inner);
            all.push(fields.text);
        }
    }

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}

#[derive(Default)]
struct Fields {
    accuses: bool,
    text: String,
}

impl Visit for Fields {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        self.accuses |= field.name() == "violation";
        self.text += &format!("{field}={value:?} ");
    }
}
