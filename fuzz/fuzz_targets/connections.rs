//! Whatever a file or another robot gives as a list of connections: taken whole, or one mistake with its place in the text.
#![no_main]
use libfuzzer_sys::fuzz_target;
use rect_router::connections::file::{parse, Limits};

const MOST: usize = 8;

fn limits() -> Limits {
    Limits {
        robot: "me".to_owned(),
        most: MOST,
    }
}

fuzz_target!(|text: &str| match parse(text, &limits()) {
    Ok(wanted) => {
        assert!(wanted.connections.len() <= MOST);
        for spec in wanted.connections {
            assert!(!spec.name.is_empty() && spec.endpoint.protocol().as_str() == spec.method);
        }
    }
    Err(mistake) => {
        let lines = text.matches('\n').count() + 1;
        assert!((1..=lines).contains(&mistake.line) && mistake.column >= 1, "{mistake}");
    }
});
