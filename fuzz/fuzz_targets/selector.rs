//! Parses untrusted selectors of registry queries. A rejected selector must have an error text.
#![no_main]
use libfuzzer_sys::fuzz_target;
use rect_router::registry::selector::Selector;
use zenoh::query::Parameters;

fuzz_target!(|text: &str| {
    if let Err(error) = Selector::parse(&Parameters::from(text)) {
        assert!(!error.is_empty());
    }
});
