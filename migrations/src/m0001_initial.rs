//! Version 1: `metadata/` (journal and index), `blobs/` (finished, by digest) and `partial/` (being written).

use std::fs::File;
use std::path::Path;

pub(crate) const FOLDERS: [&str; 3] = ["metadata", "blobs", "partial"];

pub(crate) fn migrate(folder: &Path) -> std::io::Result<()> {
    for name in FOLDERS {
        std::fs::create_dir_all(folder.join(name))?;
    }
    File::open(folder)?.sync_all()
}
