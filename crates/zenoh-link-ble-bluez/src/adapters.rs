//! Lists the adapters of this computer as Linux's files do, without BlueZ.
use std::{fs, path::Path};

/// Returns the names of the adapters, such as `hci0`, in order. `root` is the root of the file system, which tests replace.
pub fn adapters(root: &Path) -> Vec<String> {
    let entries = fs::read_dir(root.join("sys/class/bluetooth"));
    let entries = entries.into_iter().flatten().flatten();
    let names = entries.filter_map(|entry| entry.file_name().into_string().ok());
    // The folder also contains links, such as hci0:64.
    let mut adapters: Vec<_> = names
        .filter(|name| name.starts_with("hci") && !name.contains(':'))
        .collect();
    adapters.sort();
    adapters
}
