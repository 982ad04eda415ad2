//! Computes the revision of a connections file, by which an editor notices that it has been changed meanwhile.
use sha2::{Digest, Sha256};

/// Returns the revision of a text for `expect=`: the first 8 bytes of its SHA-256 in hexadecimal.
pub fn revision(text: &str) -> String {
    let digest = Sha256::digest(text.as_bytes());
    digest
        .iter()
        .take(8)
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn different_texts_have_different_revisions() {
        assert_eq!(revision("a"), revision("a"));
        assert_ne!(revision("a"), revision("b"));
        assert_eq!(revision("").len(), 16);
    }
}
