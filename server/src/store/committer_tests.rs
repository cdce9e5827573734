//! The commit thread and what opening repairs: journal and index damaged, lost and out of step.

use std::path::Path;
use std::sync::Arc;

use super::*;
use crate::store::record::{Record, Stored};

#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
struct Sign {
    id: String,
    text: String,
}

impl Record for Sign {
    const TABLE: u8 = b'!';
    const VERSION: u8 = 1;
    const NOUN: &'static str = "sign";

    fn id(&self) -> String {
        self.id.clone()
    }
}

fn sign(id: &str, text: &str) -> Sign {
    Sign {
        id: id.into(),
        text: text.into(),
    }
}

fn open(folder: &Path) -> Result<JournaledIndex> {
    JournaledIndex::open(folder, Space::new(folder, 0))
}

fn put(metadata: &dyn Metadata, id: &str, text: &str) -> Result<()> {
    metadata.commit(Txn::new().create(&sign(id, text))?)
}

fn texts(metadata: &dyn Metadata) -> Vec<String> {
    let signs: Vec<Stored<Sign>> = metadata.page("", usize::MAX).unwrap();
    signs.into_iter().map(|sign| sign.record.text).collect()
}

/// A closed store of three signs, a, b and c.
fn three_signs() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let metadata = open(folder.path()).unwrap();
    for text in ["a", "b", "c"] {
        put(&metadata, text, text).unwrap();
    }
    folder
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        match entry.file_type().unwrap().is_dir() {
            true => copy(&entry.path(), &target),
            false => std::fs::copy(entry.path(), target).map(|_| ()).unwrap(),
        }
    }
}

#[test]
fn of_many_creators_of_a_record_one_wins() {
    let folder = tempfile::tempdir().unwrap();
    let metadata = Arc::new(open(folder.path()).unwrap());
    let threads: Vec<_> = (0..8)
        .map(|thread| {
            let metadata = metadata.clone();
            std::thread::spawn(move || {
                (0..30)
                    .filter(|i| put(&*metadata, &format!("{i:02}"), &thread.to_string()).is_ok())
                    .count()
            })
        })
        .collect();
    let won: usize = threads.into_iter().map(|t| t.join().unwrap()).sum();
    assert_eq!(won, 30);
    let before = texts(&*metadata);
    assert_eq!(before.len(), 30);
    drop(metadata);
    assert_eq!(texts(&open(folder.path()).unwrap()), before);
}

#[test]
fn of_two_writers_of_a_record_the_later_reader_loses() {
    let folder = three_signs();
    let metadata: &dyn Metadata = &open(folder.path()).unwrap();
    let old: Stored<Sign> = metadata.load("a").unwrap();
    let replace = |text| metadata.commit(Txn::new().replace(&old, &sign("a", text)).unwrap());
    replace("first").unwrap();
    assert!(matches!(replace("second"), Err(Error::Conflict { .. })));
    // A transaction that conflicts in one part does nothing in the others.
    let mixed = Txn::new().create(&sign("d", "d")).unwrap().remove(&old);
    assert!(matches!(
        metadata.commit(mixed),
        Err(Error::Conflict { .. })
    ));
    assert_eq!(texts(metadata), ["first", "b", "c"]);
}

#[test]
fn a_lost_or_destroyed_index_is_rebuilt() {
    let folder = three_signs();
    std::fs::remove_dir_all(folder.path().join(INDEX)).unwrap();
    assert_eq!(texts(&open(folder.path()).unwrap()), ["a", "b", "c"]);
    std::fs::write(folder.path().join(INDEX).join("db"), [0xa5; 4_000]).unwrap();
    std::fs::write(folder.path().join(INDEX).join("conf"), "nonsense").unwrap();
    assert_eq!(texts(&open(folder.path()).unwrap()), ["a", "b", "c"]);
}

#[test]
fn an_index_that_is_behind_is_brought_up() {
    let folder = three_signs();
    let older = tempfile::tempdir().unwrap();
    copy(&folder.path().join(INDEX), older.path());
    let metadata = open(folder.path()).unwrap();
    put(&metadata, "d", "d").unwrap();
    drop(metadata);
    std::fs::remove_dir_all(folder.path().join(INDEX)).unwrap();
    copy(older.path(), &folder.path().join(INDEX));
    assert_eq!(texts(&open(folder.path()).unwrap()), ["a", "b", "c", "d"]);
}

#[test]
fn a_record_that_the_index_changed_silently_is_corrected() {
    let folder = three_signs();
    {
        let opened = Index::open(&folder.path().join(INDEX)).unwrap().unwrap();
        let wrong = super::super::record::encode(&sign("b", "wrong")).unwrap();
        let key = super::super::record::key::<Sign>("b");
        let change = Change::Put { key, value: wrong };
        opened.index.apply([&change], opened.applied_seq).unwrap();
    }
    assert_eq!(texts(&open(folder.path()).unwrap()), ["a", "b", "c"]);
}

#[test]
fn a_torn_journal_loses_the_unacknowledged_end_only() {
    let folder = three_signs();
    let path = folder.path().join(JOURNAL);
    let mut journal = std::fs::read(&path).unwrap();
    journal.extend_from_slice(b"BLJ1 half an entry");
    std::fs::write(&path, &journal).unwrap();
    let metadata = open(folder.path()).unwrap();
    assert_eq!(texts(&metadata), ["a", "b", "c"]);
    put(&metadata, "d", "d").unwrap();
    drop(metadata);
    assert_eq!(texts(&open(folder.path()).unwrap()), ["a", "b", "c", "d"]);
}

#[test]
fn a_damaged_or_lost_journal_is_written_anew_from_the_index() {
    for fault in ["flip", "cut", "lose"] {
        let folder = three_signs();
        let path = folder.path().join(JOURNAL);
        let mut journal = std::fs::read(&path).unwrap();
        match fault {
            "flip" => {
                journal[30] ^= 1;
                std::fs::write(&path, &journal).unwrap();
            }
            // The last entry was acknowledged: its loss is not the work of a crash.
            "cut" => std::fs::write(&path, &journal[..journal.len() - 1]).unwrap(),
            _ => std::fs::remove_file(&path).unwrap(),
        }
        let metadata = open(folder.path()).unwrap();
        assert_eq!(texts(&metadata), ["a", "b", "c"], "{fault}");
        put(&metadata, "d", "d").unwrap();
        drop(metadata);
        assert_eq!(
            texts(&open(folder.path()).unwrap()),
            ["a", "b", "c", "d"],
            "{fault}"
        );
    }
}

#[test]
fn an_index_that_is_behind_completes_a_damaged_journal_with_its_later_entries() {
    let folder = three_signs();
    let older = tempfile::tempdir().unwrap();
    copy(&folder.path().join(INDEX), older.path());
    put(&open(folder.path()).unwrap(), "d", "d").unwrap();
    std::fs::remove_dir_all(folder.path().join(INDEX)).unwrap();
    copy(older.path(), &folder.path().join(INDEX));
    let path = folder.path().join(JOURNAL);
    let mut journal = std::fs::read(&path).unwrap();
    journal[30] ^= 1;
    std::fs::write(&path, &journal).unwrap();
    for _ in 0..2 {
        assert_eq!(texts(&open(folder.path()).unwrap()), ["a", "b", "c", "d"]);
    }
}

#[test]
fn a_store_whose_both_halves_are_damaged_is_not_opened() {
    let folder = three_signs();
    let path = folder.path().join(JOURNAL);
    let mut journal = std::fs::read(&path).unwrap();
    journal[30] ^= 1;
    std::fs::write(&path, &journal).unwrap();
    std::fs::write(folder.path().join(INDEX).join("db"), [0xa5; 4_000]).unwrap();
    std::fs::write(folder.path().join(INDEX).join("conf"), "nonsense").unwrap();
    let error = open(folder.path()).unwrap_err();
    assert!(matches!(error, Error::Corrupt { .. }), "{error}");
    // Nothing was thrown away: the journal is as it was.
    assert_eq!(std::fs::read(&path).unwrap(), journal);
}

#[test]
fn a_full_disk_refuses_writes_and_serves_reads() {
    let folder = three_signs();
    let space = Space::new(folder.path(), u64::MAX);
    let metadata = JournaledIndex::open(folder.path(), space).unwrap();
    let error = put(&metadata, "d", "d").unwrap_err();
    assert!(matches!(error, Error::DiskFull { .. }), "{error}");
    assert_eq!(texts(&metadata), ["a", "b", "c"]);
    assert!(metadata.poisoned().is_none());
    drop(metadata);
    let metadata = open(folder.path()).unwrap();
    put(&metadata, "d", "d").unwrap();
}

#[test]
fn a_long_history_is_shortened() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(JOURNAL);
    let metadata: &dyn Metadata = &open(folder.path()).unwrap();
    put(metadata, "a", "").unwrap();
    let filler = "x".repeat(60_000);
    let rounds = CHECKPOINT_BYTES as usize / filler.len() + 2;
    let mut longest = 0;
    for round in 0..rounds {
        let old: Stored<Sign> = metadata.load("a").unwrap();
        let text = format!("{round}{filler}");
        metadata
            .commit(Txn::new().replace(&old, &sign("a", &text)).unwrap())
            .unwrap();
        longest = longest.max(std::fs::metadata(&path).unwrap().len());
    }
    assert!(
        longest >= CHECKPOINT_BYTES - 70_000,
        "no checkpoint was due"
    );
    assert!(std::fs::metadata(&path).unwrap().len() < CHECKPOINT_BYTES / 8);
    let last: Stored<Sign> = metadata.load("a").unwrap();
    assert!(last.record.text.starts_with(&(rounds - 1).to_string()));
}
