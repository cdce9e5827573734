//! A data directory that is taken, too new, foreign, or on a full disk.

use std::path::{Path, PathBuf};
use std::process::Command;

use backlot_client::upload;
use backlot_e2e::server::refused_start;
use backlot_e2e::state::{Library, files};
use backlot_e2e::{Server, logs};

#[tokio::test]
async fn a_second_server_is_refused_and_the_first_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let mut first = Server::start(&data).await;
    let (status, said) = refused_start(&data);
    assert!(!status.success(), "{said}");
    assert!(
        said.contains("another server") && said.contains(data.to_str().unwrap()),
        "the cause is not named:\n{said}"
    );
    assert!(first.is_running());
    Library::of(&first.connect().await).await;
}

#[tokio::test]
async fn a_directory_of_a_newer_version_is_refused_and_left_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let server = Server::start(&data).await;
    upload::upload_log(
        &server.connect().await,
        &logs::tiny(1),
        "driveLogs/kept",
        &|_| {},
    )
    .await
    .unwrap();
    assert!(server.stop().success());
    let format = data.join("FORMAT");
    let own = std::fs::read(&format).unwrap();
    std::fs::write(&format, "backlot 999\n").unwrap();
    let before = files(&data);
    let (status, said) = refused_start(&data);
    assert!(
        !status.success() && said.contains("999"),
        "{status}: the version is not named:\n{said}"
    );
    assert_eq!(
        files(&data),
        before,
        "a refused start changed the directory"
    );

    std::fs::write(&format, own).unwrap();
    let server = Server::start(&data).await;
    assert_eq!(
        Library::of(&server.connect().await).await.drive_logs[0].name,
        "driveLogs/kept"
    );
}

#[test]
fn a_foreign_directory_is_refused_and_left_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    std::fs::create_dir(&data).unwrap();
    std::fs::write(data.join("holiday.jpg"), "a picture").unwrap();
    let (status, said) = refused_start(&data);
    assert!(
        !status.success() && said.contains("not a Backlot data directory"),
        "{status}:\n{said}"
    );
    assert_eq!(
        std::fs::read_to_string(data.join("holiday.jpg")).unwrap(),
        "a picture"
    );
}

/// A real file system of 24 MiB. Needs the right to mount; without it the test says that it was left out.
#[tokio::test]
async fn a_full_disk_refuses_writes_and_loses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let Some(disk) = SmallDisk::mount(&folder.path().join("disk"), 24) else {
        return;
    };
    let data = disk.path.join("data");
    let limits = folder.path().join("limits.toml");
    std::fs::write(&limits, "low_water_mib = 4\nballast_mib = 2\n").unwrap();
    let arguments = ["--config", limits.to_str().unwrap()];
    let server = Server::start_on(&data, backlot_e2e::server::free_port(), &arguments).await;
    let connection = server.connect().await;
    let mut kept = Vec::new();
    let mut refusal = None;
    for seed in 0..200 {
        let name = format!("driveLogs/log-{seed}");
        match upload::upload_log(&connection, &logs::tiny(seed), &name, &|_| {}).await {
            Ok(_) => kept.push(name),
            Err(error) => {
                refusal = Some(error.to_string());
                break;
            }
        }
    }
    let refusal = refusal.expect("200 logs cannot fit");
    assert!(
        refusal.contains("RESOURCE_EXHAUSTED") && refusal.contains("disk"),
        "the cause is not named: {refusal}"
    );
    assert!(!kept.is_empty(), "nothing fitted: {refusal}");
    assert_eq!(
        names(&connection).await,
        kept,
        "reads go on while the disk is full"
    );

    server.kill();
    let server = Server::start_on(&data, backlot_e2e::server::free_port(), &arguments).await;
    assert_eq!(
        names(&server.connect().await).await,
        kept,
        "the server starts on the full disk and has everything"
    );
    disk.grow(64);
    let name = "driveLogs/after-growing";
    upload::upload_log(&server.connect().await, &logs::tiny(1000), name, &|_| {})
        .await
        .expect("there is room again");
}

async fn names(connection: &backlot_client::Connection) -> Vec<String> {
    let mut names: Vec<_> = Library::of(connection)
        .await
        .drive_logs
        .into_iter()
        .map(|log| log.name)
        .collect();
    names.sort_by_key(|name| {
        name.rsplit('-')
            .next()
            .and_then(|number| number.parse::<u64>().ok())
    });
    names
}

/// A mounted tmpfs.
struct SmallDisk {
    path: PathBuf,
}

impl SmallDisk {
    /// `None`, and a line on stderr, where mounting is not permitted.
    fn mount(path: &Path, size_mib: u32) -> Option<Self> {
        std::fs::create_dir_all(path).expect("the mount point can be made");
        let option = format!("size={size_mib}m");
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &option, "tmpfs"])
            .arg(path)
            .output();
        match mounted {
            Ok(done) if done.status.success() => Some(Self {
                path: path.to_owned(),
            }),
            Ok(done) => left_out(String::from_utf8_lossy(&done.stderr).trim()),
            Err(error) => left_out(&error.to_string()),
        }
    }

    fn grow(&self, size_mib: u32) {
        let option = format!("remount,size={size_mib}m");
        let status = Command::new("mount")
            .args(["-o", &option])
            .arg(&self.path)
            .status();
        assert!(
            status.is_ok_and(|status| status.success()),
            "the file system can be grown"
        );
    }
}

fn left_out(reason: &str) -> Option<SmallDisk> {
    use std::io::Write;
    let line = format!("LEFT OUT: the full-disk test, as no tmpfs can be mounted here: {reason}\n");
    // Past the harness, which captures what passing tests print; a closed stderr must not fail the test.
    let _ = std::io::stderr().write_all(line.as_bytes());
    None
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        // Lazily: the server may still be closing its files.
        let _ = Command::new("umount").arg("-l").arg(&self.path).status();
    }
}
