//! Reads untrusted catalogues, registrations and tokens of programs. A value that was read must be written to bytes that are read as the
//! same value, and no topic may get two servers that do not both allow it.
use std::time::{Duration, Instant};

use rect_core::{catalogue::{self, keeper::Keeper, program_name, token::Token, Program}, name::{key::KeySpace, Name}};

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    if let Ok(programs) = catalogue::read(input) {
        for program in programs {
            assert_eq!(Program::read(program.to_json().as_bytes()), Ok(program));
        }
    }
    let name = |text| Name::new(text).expect("a name");
    let place = KeySpace { fleet: name("rect"), robot: name("wombat-1") };
    let (mut keeper, mut now) = (Keeper::default(), Instant::now());
    // Each line is a registration or a token, which begins or ends.
    for line in input.split(|byte| *byte == b'\n') {
        now += Duration::from_millis(500);
        if let Ok(program) = Program::read(line) {
            let _ = keeper.register(program, now);
        }
        let Ok(text) = std::str::from_utf8(line) else {
            continue;
        };
        let _ = program_name(text);
        let (is_up, rest) = (!text.starts_with('-'), text.trim_start_matches('-'));
        let key = format!("rect/wombat-1/@rect/p/{rest}");
        if let Some(token) = Token::parse(&place, &key) {
            assert_eq!(Token::parse(&place, &token.key(&place.fleet)).as_ref(), Some(&token));
            keeper.on_token(&token, is_up, now);
        }
    }
    let programs = keeper.programs(now);
    let services = || programs.iter().flat_map(|program| program.services.iter().map(move |service| (program.instance, service)));
    for (one, service) in services() {
        for (other, same) in services().filter(|(other, same)| *other != one && same.topic == service.topic) {
            assert!(service.several && same.several, "{one} and {other} serve {}", same.topic);
        }
    }
}
