//! Blobs that arrive whole, in parts, wrong, twice and on a full disk.

use std::path::{Path, PathBuf};

use super::space::Space;
use super::*;
use crate::domain::blob::{BlobRef, Digest};

const CONTENT: &[u8] = b"a street, as bytes";

struct Site {
    folder: tempfile::TempDir,
    blobs: BlobStore,
}

impl Site {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        backlot_migrations::migrate(folder.path(), &[]).unwrap();
        let blobs = open(folder.path(), 0);
        Self { folder, blobs }
    }

    fn begin(&self, content: &[u8]) -> Upload {
        match self.blobs.begin(BlobRef::of(content)).unwrap() {
            Begun::Writing(upload) => upload,
            Begun::Present => panic!("the blob is there"),
        }
    }

    fn partial_files(&self) -> usize {
        let folder = self.folder.path().join("partial");
        std::fs::read_dir(folder).unwrap().count()
    }

    fn file_of(&self, digest: &Digest) -> PathBuf {
        let text = digest.to_string();
        self.folder
            .path()
            .join("blobs")
            .join(&text[..2])
            .join(&text)
    }
}

fn open(folder: &Path, low_water_bytes: u64) -> BlobStore {
    BlobStore::open(folder, Space::new(folder, low_water_bytes)).unwrap()
}

#[test]
fn a_blob_is_resumed_where_it_was_cut() {
    let site = Site::new();
    let digest = Digest::of(CONTENT);
    let mut upload = site.begin(CONTENT);
    upload.write(0, &CONTENT[..7]).unwrap();
    drop(upload);
    // Another process goes on.
    let blobs = open(site.folder.path(), 0);
    assert_eq!(blobs.committed(&digest).unwrap(), (7, false));
    let mut upload = site.begin(CONTENT);
    assert!(matches!(
        upload.write(0, CONTENT),
        Err(Error::WrongOffset {
            committed_bytes: 7,
            ..
        })
    ));
    upload.write(7, &CONTENT[7..]).unwrap();
    upload.finish().unwrap();
    assert_eq!(&blobs.read(&digest).unwrap()[..], CONTENT);
    assert!(matches!(
        blobs.begin(BlobRef::of(CONTENT)),
        Ok(Begun::Present)
    ));
    assert_eq!(site.partial_files(), 0);
}

#[test]
fn wrong_content_is_refused_and_removed() {
    let site = Site::new();
    let mut upload = site.begin(CONTENT);
    let wrong = vec![b'x'; CONTENT.len()];
    upload.write(0, &wrong).unwrap();
    let error = upload.finish().unwrap_err();
    assert!(matches!(error, Error::Invalid { .. }), "{error}");
    assert_eq!(site.partial_files(), 0);
    let digest = Digest::of(CONTENT);
    assert_eq!(site.blobs.committed(&digest).unwrap(), (0, false));
    assert!(matches!(
        site.blobs.read(&digest),
        Err(Error::NotFound { .. })
    ));
}

#[test]
fn content_past_the_size_and_a_wrong_size_are_refused() {
    let site = Site::new();
    let mut upload = site.begin(CONTENT);
    let long = [CONTENT, b"!"].concat();
    assert!(matches!(
        upload.write(0, &long),
        Err(Error::TooLarge { .. })
    ));
    drop(upload);
    let huge = BlobRef {
        size_bytes: MAX_BLOB_BYTES + 1,
        ..BlobRef::of(CONTENT)
    };
    assert!(matches!(
        site.blobs.begin(huge),
        Err(Error::TooLarge { .. })
    ));
    site.blobs.put(CONTENT).unwrap();
    let other_size = BlobRef {
        size_bytes: 1,
        ..BlobRef::of(CONTENT)
    };
    assert!(matches!(
        site.blobs.begin(other_size),
        Err(Error::Invalid { .. })
    ));
}

#[test]
fn one_call_writes_a_blob_at_a_time() {
    let site = Site::new();
    let first = site.begin(CONTENT);
    let second = site.blobs.begin(BlobRef::of(CONTENT));
    assert!(matches!(second, Err(Error::BlobBusy { .. })));
    drop(first);
    site.begin(CONTENT);
}

#[test]
fn every_flipped_bit_and_a_cut_are_found_when_read() {
    let site = Site::new();
    let blob = site.blobs.put(CONTENT).unwrap();
    let file = site.file_of(&blob.digest);
    for bit in 0..CONTENT.len() * 8 {
        let mut bad = CONTENT.to_vec();
        bad[bit / 8] ^= 1 << (bit % 8);
        std::fs::write(&file, &bad).unwrap();
        for outcome in [
            site.blobs.read(&blob.digest).map(|_| ()),
            site.blobs.verify(&blob.digest).map(|_| ()),
        ] {
            assert!(matches!(outcome, Err(Error::Corrupt { .. })), "bit {bit}");
        }
    }
    std::fs::write(&file, &CONTENT[..3]).unwrap();
    assert!(matches!(
        site.blobs.read(&blob.digest),
        Err(Error::Corrupt { .. })
    ));
    std::fs::write(&file, CONTENT).unwrap();
    assert_eq!(site.blobs.verify(&blob.digest).unwrap(), blob.size_bytes);
}

#[test]
fn a_full_disk_refuses_blobs_and_keeps_what_was_committed() {
    let site = Site::new();
    let kept = site.blobs.put(b"kept").unwrap();
    let mut upload = site.begin(CONTENT);
    upload.write(0, &CONTENT[..7]).unwrap();
    drop(upload);
    let full = open(site.folder.path(), u64::MAX);
    assert!(matches!(full.put(b"new"), Err(Error::DiskFull { .. })));
    let Begun::Writing(mut upload) = full.begin(BlobRef::of(CONTENT)).unwrap() else {
        panic!("it is not finished")
    };
    assert!(matches!(
        upload.write(7, &CONTENT[7..]),
        Err(Error::DiskFull { .. })
    ));
    assert_eq!(upload.committed_bytes(), 7);
    assert_eq!(&full.read(&kept.digest).unwrap()[..], b"kept");
}

#[test]
fn opening_sweeps_what_dead_processes_left_and_nothing_else() {
    let site = Site::new();
    let kept = site.blobs.put(CONTENT).unwrap();
    let mut upload = site.begin(b"half sent");
    upload.write(0, b"half").unwrap();
    drop(upload);
    let partial = site.folder.path().join("partial");
    let temporary = partial.join(format!("{}.0", Digest::of(b"dead")));
    std::fs::write(&temporary, b"de").unwrap();
    let blobs = open(site.folder.path(), 0);
    assert!(!temporary.exists());
    assert_eq!(
        blobs.committed(&Digest::of(b"half sent")).unwrap(),
        (4, false)
    );
    assert_eq!(
        blobs.size_bytes(&kept.digest).unwrap(),
        Some(kept.size_bytes)
    );
}

#[test]
fn an_empty_blob_is_a_blob() {
    let site = Site::new();
    let upload = site.begin(b"");
    assert!(upload.is_whole());
    upload.finish().unwrap();
    assert!(site.blobs.read(&Digest::of(b"")).unwrap().is_empty());
}
