//! Tests that everything is saved that is whole.
use std::{fs, path::Path};

use rect_recording::{Entry, Extras, Missing, Reader};

use crate::{entry, written};

fn recovered(path: &Path) -> (Vec<Entry>, Vec<Missing>) {
    let mut reader = Reader::open_damaged(path).expect("opened");
    let entries = reader.by_ref().collect::<Result<Vec<_>, _>>();
    Extras::of_damaged(path).expect("read");
    (entries.expect("no error"), reader.missing().to_vec())
}

#[test]
fn whole_chunks_behind_a_damaged_byte_are_recovered() {
    let folder = tempfile::tempdir().expect("a folder");
    let bytes = written(folder.path(), 40);
    let path = folder.path().join("damaged.mcap");
    fs::write(&path, &bytes).expect("written");
    let all: Vec<_> = (0..40).map(entry).collect();
    assert_eq!(recovered(&path), (all.clone(), vec![]));
    for position in 0..bytes.len() {
        for bit in [0x10, 0x80] {
            let mut damaged = bytes.clone();
            damaged[position] ^= bit;
            fs::write(&path, damaged).expect("written");
            let (entries, missing) = recovered(&path);
            assert!(entries.len() >= 30, "{position}: {}", entries.len());
            assert!(entries.len() == 40 || !missing.is_empty(), "{position}");
            let is_whole = |entry: &Entry| all.get(entry.sequence as usize) == Some(entry);
            assert!(entries.iter().all(is_whole), "{position}");
        }
    }
}

#[test]
fn damaged_chunk_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut bytes = written(folder.path(), 40);
    // In the content of the second chunk.
    let chunks = bytes.windows(4).enumerate();
    let names = chunks.filter(|(_, name)| name == b"zstd").map(|(at, _)| at);
    let second = names.collect::<Vec<_>>()[1];
    bytes[second + 40] ^= 1;
    let path = folder.path().join("damaged.mcap");
    fs::write(&path, bytes).expect("written");
    let (entries, missing) = recovered(&path);
    let expected: Vec<_> = (0..10).chain(20..40).map(entry).collect();
    assert_eq!(entries, expected);
    let chunk = missing.first().expect("a missing chunk");
    assert!(chunk.bytes.contains(&(second as u64)), "{chunk:?}");
    assert_eq!(chunk.times, Some((entry(10).logged, entry(19).logged)));
}

#[test]
fn file_that_breaks_off_is_recovered_up_to_its_last_chunk() {
    let folder = tempfile::tempdir().expect("a folder");
    let bytes = written(folder.path(), 40);
    let path = folder.path().join("half.mcap");
    let mut most = 0;
    for length in 0..bytes.len() {
        fs::write(&path, &bytes[..length]).expect("written");
        let (entries, missing) = recovered(&path);
        assert!(entries.len() >= most, "{length}");
        most = entries.len();
        assert_eq!(entries, (0..most as u32).map(entry).collect::<Vec<_>>());
        assert!(!missing.is_empty(), "{length}");
    }
    assert_eq!(most, 40);
}
