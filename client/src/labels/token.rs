//! Names of records that depend on nothing but what they name.

/// 32 hexadecimal digits of a record's kind and key.
pub(super) fn token(kind: &str, key: &[&str]) -> String {
    let mut hasher = blake3::Hasher::new();
    for part in [kind].iter().chain(key) {
        // Lengths first, so that no two lists of parts read the same.
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part.as_bytes());
    }
    hasher.finalize().to_hex()[..32].to_owned()
}
