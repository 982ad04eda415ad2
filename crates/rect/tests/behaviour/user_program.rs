//! Tests that the compiler accepts a right program of a user, and finds each wrong line.
use std::{path::Path, process::Command};

const PROGRAM: &str = include_str!("user_program/program.rs");
const MARK: &str = "// wrong";

/// Returns the lines, counted from 1, at which the compiler finds errors in a program.
fn errors(program: &str, library: &Path) -> Vec<usize> {
    let folder = tempfile::tempdir().expect("a folder");
    let source = folder.path().join("main.rs");
    std::fs::write(&source, program).expect("written");
    let dependencies = library.parent().expect("a folder");
    let rustc = std::env::var_os("RUSTC").unwrap_or("rustc".into());
    let done = Command::new(rustc)
        .args([
            "--edition=2021",
            "--emit=metadata",
            "--error-format=short",
            "--cap-lints=allow",
        ])
        .arg(format!("--extern=rect={}", library.display()))
        .arg(format!("-Ldependency={}", dependencies.display()))
        .arg(&source)
        .current_dir(folder.path())
        .output()
        .expect("rustc runs");
    let text = String::from_utf8_lossy(&done.stderr);
    let start = format!("{}:", source.display());
    let line = |text: &str| text.strip_prefix(&start)?.split(':').next()?.parse().ok();
    let mut errors: Vec<_> = text
        .lines()
        .filter(|line| line.contains(": error"))
        .filter_map(line)
        .collect();
    errors.dedup();
    assert_eq!(done.status.success(), errors.is_empty(), "{text}");
    errors
}

#[test]
fn wrong_lines_are_found_and_no_others() {
    // The one that Cargo has just built for this test; those of other features and earlier builds are there, too.
    let test = std::env::current_exe().expect("a path");
    let built = std::fs::read_dir(test.parent().expect("a folder")).expect("readable");
    let library = built
        .map(|entry| entry.expect("readable").path())
        .filter(|path| {
            let name = path.file_name().and_then(|name| name.to_str());
            name.is_some_and(|name| name.starts_with("librect-") && name.ends_with(".rlib"))
        })
        .max_by_key(|path| {
            path.metadata()
                .and_then(|about| about.modified())
                .expect("readable")
        })
        .expect("the library is built");
    let lines: Vec<_> = PROGRAM.lines().collect();
    let wrong: Vec<_> = (1..)
        .zip(&lines)
        .filter(|(_, line)| line.ends_with(MARK))
        .collect();
    assert_eq!(wrong.len(), 6);
    // One wrong line at a time, because the compiler hides some errors behind others.
    let with = |kept: usize| {
        let kept = (1..).zip(&lines).map(|(number, line)| {
            let is_left_out = line.ends_with(MARK) && number != kept;
            if is_left_out {
                ""
            } else {
                line
            }
        });
        kept.collect::<Vec<_>>().join("\n")
    };
    assert_eq!(errors(&with(0), &library), Vec::<usize>::new());
    for (number, line) in wrong {
        assert_eq!(errors(&with(number), &library), [number], "{line}");
    }
}
