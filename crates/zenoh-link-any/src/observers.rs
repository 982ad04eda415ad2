//! Calls what observes the links of this process whenever the path that carries the bulk of one has changed.
use parking_lot::Mutex;

type Observer = Box<dyn Fn() -> bool + Send>;

static OBSERVERS: Mutex<Vec<Observer>> = Mutex::new(Vec::new());

/// Calls `observer` whenever another path carries the bulk of a link, or none, until it returns `false`. It must return at once, and
/// must not ask for the [status](crate::status) of the links.
pub fn observe(observer: impl Fn() -> bool + Send + 'static) {
    OBSERVERS.lock().push(Box::new(observer));
}

/// Reports a change to the observers.
pub(crate) fn report() {
    OBSERVERS.lock().retain(|observer| observer());
}
