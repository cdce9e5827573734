//! The container's entrypoint, run outside a container: it starts the server with the image's configuration and hands signals on.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use backlot_client::Connection;
use backlot_e2e::programs::backlotd;
use backlot_e2e::server::free_port;
use backlot_e2e::state::Library;

const LIMIT: Duration = Duration::from_secs(60);

fn docker() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docker")
}

#[tokio::test]
async fn the_entrypoint_serves_and_stops_on_a_signal() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let mut server = Command::new(docker().join("entrypoint.sh"))
        .env("BACKLOTD", backlotd().get_program())
        .env("BACKLOT_CONFIG", docker().join("server.toml"))
        .arg("--data-dir")
        .arg(folder.path().join("data"))
        .args(["--listen", &format!("127.0.0.1:{port}")])
        .stdin(Stdio::null())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    let connection = loop {
        if let Ok(connection) = Connection::open(&format!("http://127.0.0.1:{port}")).await {
            break connection;
        }
        assert!(begun.elapsed() < LIMIT, "the server does not answer");
        assert!(server.try_wait().unwrap().is_none(), "the server ended");
        tokio::time::sleep(Duration::from_millis(20)).await;
    };
    assert!(Library::of(&connection).await.drive_logs.is_empty());
    // The script must have become the server: a shell in between would keep the signal for itself.
    // SAFETY: kill(2) with a process id that is ours and has not been waited for.
    let sent = unsafe { libc::kill(server.id() as libc::pid_t, libc::SIGTERM) };
    assert_eq!(sent, 0);
    assert!(server.wait().unwrap().success(), "a clean stop");
}

#[test]
fn image_and_compose_file_name_what_is_there() {
    let read = |name: &str| std::fs::read_to_string(docker().join(name)).unwrap();
    let image = read("Dockerfile");
    for line in image
        .lines()
        .filter(|line| line.starts_with("COPY docker/"))
    {
        let source = line.split_whitespace().nth(1).unwrap();
        assert!(docker().join("..").join(source).exists(), "{line}");
    }
    let port = "50051";
    for (name, text) in [
        ("Dockerfile", &image),
        ("compose.yaml", &read("compose.yaml")),
        ("server.toml", &read("server.toml")),
    ] {
        assert!(text.contains(port), "{name} does not name port {port}");
    }
}
