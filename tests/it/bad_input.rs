//! Bad input: every case gets a status that names its cause, and the library stays as it was.

use backlot_client::read_log::{BlobSource, ReadLog};
use backlot_client::{Connection, upload};
use backlot_e2e::programs::finish;
use backlot_e2e::state::Library;
use backlot_e2e::{Finished, Server, backlot, logs};
use backlot_proto::v1;
use bytes::Bytes;
use tonic::{Code, Status};
use tonic_types::StatusExt;

/// What a call with bad input came to.
struct Refusal {
    case: &'static str,
    status: Status,
    codes: &'static [Code],
    /// All of these must be in the message or in the violated fields.
    names: &'static [&'static str],
}

#[tokio::test]
async fn every_bad_call_is_refused_by_name_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("data")).await;
    let connection = server.connect().await;
    upload::upload_log(&connection, &logs::tiny(1), "driveLogs/good", &|_| {})
        .await
        .unwrap();
    let before = Library::of(&connection).await;

    let refusals = [
        truncated_image(&connection).await,
        damaged_image(&connection).await,
        nan_pose(&connection).await,
        missing_camera(&connection).await,
        missing_blob(&connection).await,
        other_content_of_a_name(&connection).await,
        wrong_digest(&connection).await,
        damaged_chunk(&connection).await,
        chunk_over_the_limit(&connection).await,
        message_over_the_limit(&connection).await,
        unknown_asset(&connection).await,
        unknown_log(&connection).await,
        unknown_job(&connection).await,
    ];
    let mut wrong = Vec::new();
    for Refusal {
        case,
        status,
        codes,
        names,
    } in refusals
    {
        let text = text(&status);
        if !codes.contains(&status.code()) {
            wrong.push(format!(
                "{case}: {:?} instead of {codes:?}: {text}",
                status.code()
            ));
        }
        let missing: Vec<_> = names.iter().filter(|name| !text.contains(**name)).collect();
        if !missing.is_empty() {
            wrong.push(format!("{case}: does not name {missing:?}: {text}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert_eq!(
        Library::of(&connection).await,
        before,
        "a refused call changed the library"
    );
    upload::upload_log(&connection, &logs::tiny(1), "driveLogs/good", &|_| {})
        .await
        .expect("good input still works");
}

#[tokio::test]
async fn the_command_line_names_the_cause_and_fails() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("data")).await;
    let empty = folder.path().join("2011_09_26_drive_0001_sync");
    std::fs::create_dir_all(empty.join("image_02/data")).unwrap();
    std::fs::write(empty.join("image_02/data/0000000000.png"), b"not an image").unwrap();
    let path = empty.to_str().unwrap();
    let out_of = folder.path().to_str().unwrap();
    let out = folder.path().join("out");
    let out = out.to_str().unwrap();
    let cases: [(&str, &[&str], &[&str]); 7] = [
        (
            "unknown format",
            &["logs", "upload", "--format", "once", "--name", "x", path],
            &["once", "kitti-raw"],
        ),
        (
            "another data set",
            &["logs", "upload", "--format", "waymo", "--name", "x", path],
            &["camera_image", path],
        ),
        (
            "no known layout",
            &["logs", "upload", "--name", "x", out_of],
            &[out_of, "nuscenes"],
        ),
        (
            "missing calibration",
            &[
                "logs",
                "upload",
                "--format",
                "kitti-raw",
                "--name",
                "x",
                path,
            ],
            &["calib"],
        ),
        (
            "missing folder",
            &[
                "logs",
                "upload",
                "--format",
                "kitti-raw",
                "--name",
                "x",
                "/nowhere",
            ],
            &["/nowhere"],
        ),
        (
            "unknown asset",
            &[
                "augment",
                "--background",
                "no-such-asset",
                "--count",
                "1",
                "--out",
                out,
            ],
            &["no-such-asset"],
        ),
        (
            "unknown log",
            &["jobs", "submit", "background", "--log", "no-such-log"],
            &["no-such-log"],
        ),
    ];
    let connection = server.connect().await;
    let before = Library::of(&connection).await;
    for (case, arguments, names) in cases {
        let Finished {
            code,
            stderr,
            stdout,
        } = finish(&mut backlot(&server.url(), arguments));
        assert!(
            code.is_some_and(|code| code != 0),
            "{case} exits with {code:?}:\n{stdout}{stderr}"
        );
        for name in names {
            assert!(
                stderr.contains(name),
                "{case}: {name:?} is not named:\n{stderr}"
            );
        }
        assert!(!stderr.contains("panicked"), "{case}:\n{stderr}");
    }
    assert_eq!(Library::of(&connection).await, before);
    let nobody = finish(&mut backlot("http://127.0.0.1:9", &["assets", "list"]));
    assert!(
        nobody.code != Some(0) && nobody.stderr.contains("127.0.0.1:9"),
        "{nobody:?}"
    );
}

async fn truncated_image(connection: &Connection) -> Refusal {
    let mut log = logs::tiny(2);
    let image = log.drive_log.frames[3]
        .image
        .clone()
        .expect("frames have images");
    let whole = content(&log, &image.digest);
    let cut = log.add_bytes(whole.slice(..whole.len() / 2));
    log.drive_log.frames[3].image = Some(cut);
    refused_log("truncated image", connection, &log, &["frames[3]", "image"]).await
}

/// A file whose ends are those of an image; only its middle is not.
async fn damaged_image(connection: &Connection) -> Refusal {
    let mut log = logs::tiny(2);
    let image = log.drive_log.frames[5]
        .image
        .clone()
        .expect("frames have images");
    let mut damaged = content(&log, &image.digest).to_vec();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0x10;
    let folder = tempfile::tempdir().expect("a folder can be made");
    let path = folder.path().join("damaged_000005.png");
    std::fs::write(&path, &damaged).expect("files can be written");
    let blob = log.add_bytes(damaged);
    log.blobs
        .insert(blob.digest.clone(), BlobSource::File(path));
    log.drive_log.frames[5].image = Some(blob);
    let named = &["frames[5]", "does not decode", "damaged_000005.png"];
    refused_log("damaged image", connection, &log, named).await
}

async fn nan_pose(connection: &Connection) -> Refusal {
    let mut log = logs::tiny(2);
    let pose = log.drive_log.world_from_ego[2]
        .pose
        .as_mut()
        .expect("poses are given");
    pose.translation_m
        .as_mut()
        .expect("translations are given")
        .y = f64::NAN;
    refused_log("NaN pose", connection, &log, &["world_from_ego[2]"]).await
}

async fn missing_camera(connection: &Connection) -> Refusal {
    let mut log = logs::tiny(2);
    log.drive_log.cameras.clear();
    refused_log("missing calibration", connection, &log, &["camera"]).await
}

/// A manifest that names a blob nobody uploaded.
async fn missing_blob(connection: &Connection) -> Refusal {
    let mut log = logs::tiny(2);
    let digest = blake3::hash(b"never uploaded").to_hex().to_string();
    log.drive_log.frames[1].image = Some(v1::BlobRef {
        digest,
        size_bytes: 14,
    });
    let mut refusal = refused_log("missing blob", connection, &log, &["frames[1]"]).await;
    refusal.codes = &[
        Code::FailedPrecondition,
        Code::InvalidArgument,
        Code::NotFound,
    ];
    refusal
}

async fn other_content_of_a_name(connection: &Connection) -> Refusal {
    let mut log = logs::tiny(1);
    log.drive_log.notes.push("another manifest".to_owned());
    log.drive_log.frames.pop();
    let error = upload::upload_log(connection, &log, "driveLogs/good", &|_| {})
        .await
        .expect_err("the name is taken");
    Refusal {
        case: "name taken",
        status: status_of(error),
        codes: &[Code::AlreadyExists],
        names: &["driveLogs/good"],
    }
}

async fn refused_log(
    case: &'static str,
    connection: &Connection,
    log: &ReadLog,
    names: &'static [&'static str],
) -> Refusal {
    let error = upload::upload_log(connection, log, "driveLogs/bad", &|_| {})
        .await
        .expect_err(case);
    Refusal {
        case,
        status: status_of(error),
        codes: &[Code::InvalidArgument],
        names,
    }
}

async fn wrong_digest(connection: &Connection) -> Refusal {
    let digest = blake3::hash(b"something else").to_hex().to_string();
    let status = write_blob(connection, &digest, b"content", crc32c::crc32c(b"content")).await;
    let missing = connection
        .blobs()
        .find_missing_blobs(v1::FindMissingBlobsRequest {
            digests: vec![digest.clone()],
        })
        .await
        .unwrap()
        .into_inner();
    assert_eq!(
        missing.missing_digests,
        [digest],
        "bytes with a wrong digest were kept"
    );
    Refusal {
        case: "wrong digest",
        status,
        codes: &[Code::InvalidArgument, Code::DataLoss],
        names: &["digest"],
    }
}

async fn damaged_chunk(connection: &Connection) -> Refusal {
    let digest = blake3::hash(b"content").to_hex().to_string();
    let status = write_blob(connection, &digest, b"content", 1).await;
    Refusal {
        case: "damaged chunk",
        status,
        codes: &[Code::InvalidArgument, Code::DataLoss],
        names: &["crc"],
    }
}

async fn chunk_over_the_limit(connection: &Connection) -> Refusal {
    let content = vec![7; (1 << 20) + 1];
    let digest = blake3::hash(&content).to_hex().to_string();
    let status = write_blob(connection, &digest, &content, crc32c::crc32c(&content)).await;
    let codes = &[
        Code::InvalidArgument,
        Code::OutOfRange,
        Code::ResourceExhausted,
    ];
    Refusal {
        case: "chunk over the limit",
        status,
        codes,
        names: &["1048576"],
    }
}

async fn message_over_the_limit(connection: &Connection) -> Refusal {
    let content = vec![7; 96 << 20];
    let digest = blake3::hash(&content).to_hex().to_string();
    let status = write_blob(connection, &digest, &content, 0).await;
    let codes = &[
        Code::OutOfRange,
        Code::ResourceExhausted,
        Code::InvalidArgument,
    ];
    Refusal {
        case: "message over the limit",
        status,
        codes,
        names: &["limit"],
    }
}

async fn unknown_asset(connection: &Connection) -> Refusal {
    let recipe = v1::Recipe {
        background: "assets/00000000-0000-7000-8000-000000000000".to_owned(),
        ..Default::default()
    };
    let request = v1::StreamSamplesRequest {
        recipe: Some(recipe),
        seed: 1,
        start_index: 0,
        count: 1,
    };
    let status = match connection.samples().stream_samples(request).await {
        Err(status) => status,
        Ok(stream) => stream
            .into_inner()
            .message()
            .await
            .expect_err("there is no such background"),
    };
    Refusal {
        case: "unknown asset",
        status,
        codes: &[Code::NotFound],
        names: &["00000000-0000-7000-8000-000000000000"],
    }
}

async fn unknown_log(connection: &Connection) -> Refusal {
    let request = v1::CreateJobRequest {
        kind: v1::JobKind::Background.into(),
        drive_log: "driveLogs/no-such-log".to_owned(),
        ..Default::default()
    };
    let status = connection
        .jobs()
        .create_job(request)
        .await
        .expect_err("there is no such log");
    Refusal {
        case: "unknown log",
        status,
        codes: &[Code::NotFound],
        names: &["no-such-log"],
    }
}

async fn unknown_job(connection: &Connection) -> Refusal {
    let name = "jobs/00000000-0000-7000-8000-000000000000".to_owned();
    let status = connection
        .jobs()
        .get_job(v1::GetJobRequest { name })
        .await
        .expect_err("there is no such job");
    Refusal {
        case: "unknown job",
        status,
        codes: &[Code::NotFound],
        names: &["00000000-0000"],
    }
}

/// Writes one chunk as a blob and returns the refusal.
async fn write_blob(
    connection: &Connection,
    digest: &str,
    chunk: &[u8],
    chunk_crc32c: u32,
) -> Status {
    let blob = v1::BlobRef {
        digest: digest.to_owned(),
        size_bytes: chunk.len() as u64,
    };
    let message = v1::WriteBlobRequest {
        blob: Some(blob),
        offset: 0,
        chunk: Bytes::copy_from_slice(chunk),
        chunk_crc32c,
    };
    let reply = connection
        .blobs()
        .write_blob(futures::stream::iter([message]))
        .await;
    reply.expect_err("the write is bad")
}

fn content(log: &ReadLog, digest: &str) -> Bytes {
    log.blobs[digest].read().expect("the blob is readable")
}

fn status_of(error: backlot_client::Error) -> Status {
    match error {
        backlot_client::Error::Status { status, .. } => *status,
        other => panic!("the server did not answer with a status: {other}"),
    }
}

/// Message, violated fields and reason: all that a client can show.
fn text(status: &Status) -> String {
    let mut text = status.message().to_owned();
    let details = status.get_error_details();
    for violation in details
        .bad_request()
        .iter()
        .flat_map(|bad_request| &bad_request.field_violations)
    {
        text += &format!("; {}: {}", violation.field, violation.description);
    }
    text
}
