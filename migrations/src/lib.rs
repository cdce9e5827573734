//! Numbered migrations of the data directory. Each is frozen once released and never uses the server's present types.
//!
//! The file FORMAT holds the version as `backlot N`. A migration may be repeated after a crash; the version is written,
//! durably, after its migration is done. A directory of a newer version is left as it is.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

mod m0001_initial;

/// The version that this build reads and writes.
pub const FORMAT: u32 = MIGRATIONS.len() as u32;

type Migration = fn(&Path) -> std::io::Result<()>;

/// Entry N - 1 makes version N of version N - 1.
const MIGRATIONS: [Migration; 1] = [m0001_initial::migrate];

#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error(
        "the data directory {} has format {found}, this server knows up to {FORMAT}; use a newer server",
        path.display()
    )]
    Newer { path: PathBuf, found: u32 },
    #[error("{} is not empty and is not a Backlot data directory (it has no file FORMAT)", path.display())]
    Foreign { path: PathBuf },
    #[error("{} does not say a format version", path.display())]
    Unreadable { path: PathBuf },
    #[error("migrate {}: {source}", path.display())]
    Io {
        path: PathBuf,
        source: std::io::Error,
    },
}

/// Brings the data directory to [`FORMAT`]; returns the version it had, 0 for a new one. `ignored` names files of the
/// caller (its lock) that do not make a directory foreign.
pub fn migrate(folder: &Path, ignored: &[&str]) -> Result<u32, Error> {
    let at = |source| Error::Io {
        path: folder.to_owned(),
        source,
    };
    let found = read_version(folder, ignored)?;
    if found > FORMAT {
        return Err(Error::Newer {
            path: folder.to_owned(),
            found,
        });
    }
    for (version, migration) in (1..).zip(MIGRATIONS).skip(found as usize) {
        migration(folder).map_err(at)?;
        write_version(folder, version).map_err(at)?;
    }
    Ok(found)
}

fn read_version(folder: &Path, ignored: &[&str]) -> Result<u32, Error> {
    let path = folder.join("FORMAT");
    match std::fs::read_to_string(&path) {
        Ok(text) => text
            .trim_end()
            .strip_prefix("backlot ")
            .and_then(|version| version.parse().ok())
            .ok_or(Error::Unreadable { path }),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            if is_foreign(folder, ignored).map_err(|source| Error::Io {
                path: folder.to_owned(),
                source,
            })? {
                return Err(Error::Foreign {
                    path: folder.to_owned(),
                });
            }
            Ok(0)
        }
        Err(source) => Err(Error::Io { path, source }),
    }
}

/// Files that neither the caller, nor the file system, nor an interrupted first migration made.
fn is_foreign(folder: &Path, ignored: &[&str]) -> std::io::Result<bool> {
    let own = ["lost+found", "FORMAT.new"];
    for entry in std::fs::read_dir(folder)? {
        let name = entry?.file_name();
        let name = name.to_string_lossy();
        let known = ignored.contains(&&*name)
            || own.contains(&&*name)
            || m0001_initial::FOLDERS.contains(&&*name);
        if !known {
            return Ok(true);
        }
    }
    Ok(false)
}

fn write_version(folder: &Path, version: u32) -> std::io::Result<()> {
    let fresh = folder.join("FORMAT.new");
    let mut file = File::create(&fresh)?;
    writeln!(file, "backlot {version}")?;
    file.sync_all()?;
    std::fs::rename(&fresh, folder.join("FORMAT"))?;
    File::open(folder)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_directory_is_migrated_once() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(migrate(folder.path(), &[]).unwrap(), 0);
        assert_eq!(migrate(folder.path(), &[]).unwrap(), FORMAT);
        let text = std::fs::read_to_string(folder.path().join("FORMAT")).unwrap();
        assert_eq!(text, format!("backlot {FORMAT}\n"));
    }

    #[test]
    fn a_first_migration_cut_at_any_step_is_completed() {
        for step in m0001_initial::FOLDERS {
            let folder = tempfile::tempdir().unwrap();
            std::fs::create_dir(folder.path().join(step)).unwrap();
            std::fs::write(folder.path().join("FORMAT.new"), "back").unwrap();
            assert_eq!(migrate(folder.path(), &[]).unwrap(), 0);
        }
    }

    #[test]
    fn newer_foreign_and_unreadable_directories_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("FORMAT"), "backlot 999\n").unwrap();
        let error = migrate(folder.path(), &[]).unwrap_err();
        assert!(matches!(error, Error::Newer { found: 999, .. }), "{error}");
        std::fs::write(folder.path().join("FORMAT"), "what").unwrap();
        assert!(matches!(
            migrate(folder.path(), &[]),
            Err(Error::Unreadable { .. })
        ));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);

        let foreign = tempfile::tempdir().unwrap();
        std::fs::write(foreign.path().join("thesis.tex"), "").unwrap();
        assert!(matches!(
            migrate(foreign.path(), &["LOCK"]),
            Err(Error::Foreign { .. })
        ));
        assert_eq!(std::fs::read_dir(foreign.path()).unwrap().count(), 1);
    }
}
