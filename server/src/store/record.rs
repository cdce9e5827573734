//! The form of every metadata record: `[version u8][crc32c u32 LE][JSON]`.

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::error::{Error, Result};

/// Longest record in bytes: metadata stays small, larger reports are blobs.
pub(super) const MAX_RECORD_BYTES: usize = 64 << 10;

const HEADER_BYTES: usize = 5;

/// A type that is stored as records of one table.
pub trait Record: Serialize + DeserializeOwned {
    /// First byte of its keys; never reused.
    const TABLE: u8;
    /// Written before each record; a migration rewrites records when it grows.
    const VERSION: u8;
    /// For messages, e.g. "job".
    const NOUN: &'static str;

    /// The rest of its key.
    fn id(&self) -> String;
}

/// A record and the bytes it was read from, which a transaction can require to be still there.
#[derive(Clone, Debug)]
pub struct Stored<T> {
    pub record: T,
    pub(super) raw: Vec<u8>,
}

/// The key of a record.
pub(super) fn key<T: Record>(id: &str) -> Vec<u8> {
    let mut key = Vec::with_capacity(1 + id.len());
    key.push(T::TABLE);
    key.extend_from_slice(id.as_bytes());
    key
}

pub(super) fn encode<T: Record>(record: &T) -> Result<Vec<u8>> {
    let mut out = vec![0; HEADER_BYTES];
    serde_json::to_writer(&mut out, record).map_err(|e| Error::Invalid {
        what: format!("{} {} cannot be stored: {e}", T::NOUN, record.id()),
    })?;
    if out.len() > MAX_RECORD_BYTES {
        return Err(Error::TooLarge {
            what: format!("record of {} {}", T::NOUN, record.id()),
            size_bytes: out.len() as u64,
            limit_bytes: MAX_RECORD_BYTES as u64,
        });
    }
    out[0] = T::VERSION;
    let crc = checksum(&out);
    out[1..HEADER_BYTES].copy_from_slice(&crc.to_le_bytes());
    Ok(out)
}

pub(super) fn decode<T: Record>(id: &str, raw: Vec<u8>) -> Result<Stored<T>> {
    let corrupt = |why: &str| Error::corrupt(format!("record of {} {id} ({why})", T::NOUN));
    if !is_intact(&raw) {
        return Err(corrupt("checksum"));
    }
    if raw[0] != T::VERSION {
        return Err(corrupt("unknown version"));
    }
    let record =
        serde_json::from_slice(&raw[HEADER_BYTES..]).map_err(|e| corrupt(&e.to_string()))?;
    Ok(Stored { record, raw })
}

/// Whether the bytes are a whole record with the right checksum.
pub(super) fn is_intact(raw: &[u8]) -> bool {
    raw.len() > HEADER_BYTES && raw[1..HEADER_BYTES] == checksum(raw).to_le_bytes()
}

/// Covers the version byte and the body.
fn checksum(raw: &[u8]) -> u32 {
    crc32c::crc32c_append(crc32c::crc32c(&raw[..1]), &raw[HEADER_BYTES..])
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Sign {
        id: String,
        height_m: f64,
    }

    impl Record for Sign {
        const TABLE: u8 = b'!';
        const VERSION: u8 = 1;
        const NOUN: &'static str = "sign";

        fn id(&self) -> String {
            self.id.clone()
        }
    }

    fn sign() -> Sign {
        Sign {
            id: "stop".into(),
            height_m: 2.25,
        }
    }

    #[test]
    fn the_bytes_of_version_1_are_frozen() {
        let raw = encode(&sign()).unwrap();
        assert_eq!(raw[0], 1);
        assert_eq!(&raw[5..], br#"{"id":"stop","height_m":2.25}"#);
        assert_eq!(
            raw[1..5],
            crc32c::crc32c(&[&[1], &raw[5..]].concat()).to_le_bytes()
        );
        assert_eq!(decode::<Sign>("stop", raw).unwrap().record, sign());
    }

    #[test]
    fn every_flipped_bit_and_every_cut_is_found() {
        let raw = encode(&sign()).unwrap();
        for bit in 0..raw.len() * 8 {
            let mut bad = raw.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(decode::<Sign>("stop", bad).is_err(), "bit {bit}");
        }
        for length in 0..raw.len() {
            assert!(decode::<Sign>("stop", raw[..length].to_vec()).is_err());
        }
    }

    #[test]
    fn a_record_over_the_limit_is_refused() {
        let mut long = sign();
        long.id = "x".repeat(MAX_RECORD_BYTES);
        assert!(matches!(encode(&long), Err(Error::TooLarge { .. })));
    }
}
