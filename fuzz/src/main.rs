//! Fuzz targets of all parsers of data from a peer or a user: `scripts/fuzz`. One program contains all of them, because linking Zenoh
//! for each would take longer than fuzzing. The variable `RECT_FUZZ_TARGET` selects one by the name of its module.
#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;

/// Declares the modules of the targets, and the table in which they are found by name.
macro_rules! targets {
    ($($name:ident),+ $(,)?) => {
        $(mod $name;)+

        /// The targets by name.
        const TARGETS: &[(&str, fn(&[u8]))] = &[$((stringify!($name), $name::run)),+];
    };
}

targets! {
    action,
    advertisement,
    any,
    attachment,
    catalogue,
    codec,
    compression,
    connections,
    feedback,
    hello,
    lanes,
    locator,
    log,
    meeting,
    parameters,
    raw,
    recording,
    sdu,
    selector,
    state,
    transfer,
    usage,
    video,
}

/// The target that `RECT_FUZZ_TARGET` selects.
static TARGET: LazyLock<fn(&[u8])> = LazyLock::new(|| {
    let chosen = std::env::var("RECT_FUZZ_TARGET").unwrap_or_default();
    let Some((_, run)) = TARGETS.iter().find(|(name, _)| *name == chosen) else {
        let names: Vec<_> = TARGETS.iter().map(|(name, _)| *name).collect();
        eprintln!("fuzz: set RECT_FUZZ_TARGET to one of: {}", names.join(" "));
        std::process::exit(2);
    };
    *run
});

fuzz_target!(|input: &[u8]| TARGET(input));
