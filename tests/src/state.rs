//! What must be the same before and after a refused call.

use std::collections::BTreeMap;
use std::path::Path;

use backlot_client::{Connection, listing};
use backlot_proto::v1;

/// Everything a client can see of the library.
#[derive(Clone, Debug, PartialEq)]
pub struct Library {
    pub drive_logs: Vec<v1::DriveLogSummary>,
    pub jobs: Vec<v1::Job>,
    pub assets: Vec<v1::Asset>,
}

impl Library {
    /// # Panics
    /// If the server does not answer.
    pub async fn of(connection: &Connection) -> Self {
        Self {
            drive_logs: listing::drive_logs(connection)
                .await
                .expect("drive logs are listed"),
            jobs: listing::jobs(connection, "")
                .await
                .expect("jobs are listed"),
            assets: listing::assets(connection, v1::AssetKind::Unspecified, "")
                .await
                .expect("assets are listed"),
        }
    }
}

/// Every file of a folder with the digest of its content.
///
/// # Panics
/// If a file cannot be read.
pub fn files(folder: &Path) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(&next).expect("the folder is readable") {
            let path = entry.expect("its entries are readable").path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let content = std::fs::read(&path).expect("the file is readable");
            let name = path
                .strip_prefix(folder)
                .expect("it lies in the folder")
                .to_string_lossy()
                .into_owned();
            found.insert(name, blake3::hash(&content).to_hex().to_string());
        }
    }
    found
}
