//! Whatever somebody asks the registry with.
#![no_main]
use libfuzzer_sys::fuzz_target;
use rect_router::registry::selector::Selector;
use zenoh::query::Parameters;

fuzz_target!(|text: &str| {
    if let Err(wrong) = Selector::parse(&Parameters::from(text)) {
        assert!(!wrong.is_empty());
    }
});
