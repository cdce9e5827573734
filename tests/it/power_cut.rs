//! SIGKILL of the server during upload, training and publishing: nothing acknowledged is lost, and it starts again by itself.
//!
//! The normal run kills 6 times. The long form kills 20 times:
//! `cargo test -p backlot-e2e --test it power_cut -- --ignored --nocapture`; `BACKLOT_KILL_SEED=N` repeats a run.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use backlot_client::read_log::{BlobSource, ReadLog};
use backlot_client::{Connection, download, listing, watch};
use backlot_e2e::logs;
use backlot_e2e::server::{Server, free_port};
use backlot_proto::v1;
use bytes::Bytes;

#[tokio::test]
async fn six_kills_lose_nothing_acknowledged() {
    Campaign::run(Kills {
        upload: 3,
        training: 2,
        publish: 1,
    })
    .await;
}

#[tokio::test]
#[ignore = "takes several minutes; the normal run has the short form"]
async fn twenty_kills_lose_nothing_acknowledged() {
    Campaign::run(Kills {
        upload: 9,
        training: 7,
        publish: 4,
    })
    .await;
}

/// How often to kill in each phase.
struct Kills {
    upload: u32,
    training: u32,
    publish: u32,
}

/// What the server said it has.
#[derive(Default)]
struct Acknowledged {
    blobs: BTreeSet<String>,
    logs: BTreeMap<String, v1::DriveLog>,
    jobs: BTreeSet<String>,
    /// Payload digest by asset.
    assets: BTreeMap<String, v1::BlobRef>,
}

struct Campaign {
    data: PathBuf,
    port: u16,
    seed: u64,
    draws: Draws,
    acknowledged: Acknowledged,
    /// Kills that really hit a server in the phase.
    hits: BTreeMap<&'static str, u32>,
}

impl Campaign {
    async fn run(kills: Kills) {
        let seed = kill_seed();
        println!("BACKLOT_KILL_SEED={seed}");
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let data = folder.path().join("data");
        let mut campaign = Self {
            data,
            port: free_port(),
            seed,
            draws: Draws(seed),
            acknowledged: Acknowledged::default(),
            hits: BTreeMap::new(),
        };
        for round in 0..kills.upload {
            campaign.kill_during_upload(round).await;
        }
        for round in 0..kills.training {
            campaign
                .kill_during_job("training", round, |job| stage(job) == "train")
                .await;
        }
        for round in 0..kills.publish {
            campaign
                .kill_during_job("publish", round, |job| stage(job) == "publish")
                .await;
        }
        println!("seed {seed}: kills by phase {:?}", campaign.hits);
        let wanted = [
            ("publish", kills.publish),
            ("training", kills.training),
            ("upload", kills.upload),
        ];
        assert_eq!(
            campaign.hits,
            BTreeMap::from(wanted),
            "seed {seed}: a kill did not hit its phase"
        );
        campaign.finish_every_job().await;
    }

    /// Starts the server, which must need no help, and checks everything that was ever acknowledged.
    async fn start(&self) -> (Server, Connection) {
        let server = Server::start_on(&self.data, self.port, &[]).await;
        let connection = server.connect().await;
        self.acknowledged.check(&connection, self.seed).await;
        (server, connection)
    }

    /// Uploads a log and kills the server between or during two of its acknowledgements, then completes the upload.
    async fn kill_during_upload(&mut self, round: u32) {
        let log = logs::tiny(100 + u64::from(round));
        let name = format!("driveLogs/log-{round}");
        let (server, connection) = self.start().await;
        let after = self.draws.below(log.blobs.len() as u64) as usize;
        let pause = Duration::from_micros(self.draws.below(20_000));
        let mut acknowledgements = 0;
        let mut server = Some(server);
        for (digest, source) in &log.blobs {
            if acknowledgements == after && server.is_some() {
                // The next write is on its way while the kill comes.
                let killed = server.take().expect("it is there");
                let kill = async {
                    tokio::time::sleep(pause).await;
                    killed.kill();
                };
                let (written, ()) = tokio::join!(write_blob(&connection, digest, source), kill);
                if written {
                    self.acknowledged.blobs.insert(digest.clone());
                }
                *self.hits.entry("upload").or_default() += 1;
                break;
            }
            assert!(
                write_blob(&connection, digest, source).await,
                "a running server takes blobs"
            );
            self.acknowledged.blobs.insert(digest.clone());
            acknowledgements += 1;
        }
        let (_server, connection) = self.start().await;
        self.complete_upload(&connection, &log, &name).await;
    }

    async fn complete_upload(&mut self, connection: &Connection, log: &ReadLog, name: &str) {
        let uploaded = backlot_client::upload::upload_log(connection, log, name, &|_| {}).await;
        let uploaded = uploaded.expect("an upload can be completed after a kill");
        self.acknowledged.blobs.extend(log.blobs.keys().cloned());
        self.acknowledged
            .logs
            .insert(name.to_owned(), uploaded.drive_log);
    }

    /// Runs a job and kills the server once the job is in the phase.
    async fn kill_during_job(
        &mut self,
        phase: &'static str,
        round: u32,
        in_phase: impl Fn(&v1::Job) -> bool,
    ) {
        let (server, connection) = self.start().await;
        let request = v1::CreateJobRequest {
            kind: v1::JobKind::Background.into(),
            drive_log: "driveLogs/log-0".to_owned(),
            budget: v1::Budget::Quick.into(),
            seed: u64::from(round),
            ..Default::default()
        };
        let job = watch::create_job(&connection, request)
            .await
            .expect("a running server takes jobs");
        self.acknowledged.jobs.insert(job.name.clone());
        let mut stream = connection
            .jobs()
            .watch_job(v1::WatchJobRequest {
                name: job.name.clone(),
            })
            .await
            .expect("a job can be watched")
            .into_inner();
        // Publishing is short, training is not.
        let pause = if phase == "publish" {
            self.draws.below(30)
        } else {
            self.draws.below(1500)
        };
        while let Ok(Some(message)) = stream.message().await {
            let job = message.job.expect("a message holds a job");
            assert!(
                !watch::is_finished(&job),
                "{phase}: the job ended before it was in the phase: {job:?}"
            );
            if in_phase(&job) {
                tokio::time::sleep(Duration::from_millis(pause)).await;
                server.kill();
                *self.hits.entry(phase).or_default() += 1;
                return;
            }
        }
        panic!("{phase}: the watch ended:\n{}", server.log_text());
    }

    /// Every acknowledged job ends by itself, with an asset that can be read.
    async fn finish_every_job(&mut self) {
        let (_server, connection) = self.start().await;
        for name in self.acknowledged.jobs.clone() {
            let job = watch::watch_job(&connection, &name, |_| {})
                .await
                .expect("a job can be watched to its end");
            assert_eq!(job.state(), v1::JobState::Succeeded, "{job:?}");
            assert_eq!(
                job.assets.len(),
                1,
                "one asset a job, however often it was begun: {job:?}"
            );
        }
        for asset in listing::assets(&connection, v1::AssetKind::Unspecified, "")
            .await
            .expect("assets are listed")
        {
            self.acknowledged
                .assets
                .insert(asset.name, asset.payload.expect("assets have payloads"));
        }
        assert_eq!(
            self.acknowledged.assets.len(),
            self.acknowledged.jobs.len(),
            "one asset a job"
        );
        self.acknowledged.check(&connection, self.seed).await;
    }
}

impl Acknowledged {
    async fn check(&self, connection: &Connection, seed: u64) {
        let digests = self.blobs.iter().cloned().collect();
        let missing = connection
            .blobs()
            .find_missing_blobs(v1::FindMissingBlobsRequest { digests })
            .await;
        let missing = missing
            .expect("the server answers")
            .into_inner()
            .missing_digests;
        assert!(
            missing.is_empty(),
            "seed {seed}: {} acknowledged blobs are lost: {missing:?}",
            missing.len()
        );
        for (name, expected) in &self.logs {
            let request = v1::GetDriveLogRequest { name: name.clone() };
            let reply = connection.drive_logs().get_drive_log(request).await;
            let found = reply
                .unwrap_or_else(|status| panic!("seed {seed}: {name} is lost: {status}"))
                .into_inner()
                .drive_log;
            assert_eq!(
                found.as_ref(),
                Some(expected),
                "seed {seed}: {name} changed"
            );
        }
        for name in &self.jobs {
            let reply = connection
                .jobs()
                .get_job(v1::GetJobRequest { name: name.clone() })
                .await;
            assert!(reply.is_ok(), "seed {seed}: {name} is lost: {reply:?}");
        }
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        for (name, payload) in &self.assets {
            let path = folder.path().join("payload");
            let read = download::download_blob(connection, payload, &path).await;
            read.unwrap_or_else(|error| {
                panic!("seed {seed}: the payload of {name} is lost: {error}")
            });
        }
    }
}

fn stage(job: &v1::Job) -> &str {
    job.progress
        .as_ref()
        .map_or("", |progress| progress.stage.as_str())
}

/// Writes a blob in small chunks; false if the connection broke before the acknowledgement.
async fn write_blob(connection: &Connection, digest: &str, source: &BlobSource) -> bool {
    let content = match source {
        BlobSource::Memory(content) => content.clone(),
        BlobSource::File(path) => read(path),
    };
    let blob = v1::BlobRef {
        digest: digest.to_owned(),
        size_bytes: content.len() as u64,
    };
    let messages: Vec<_> = (0..content.len())
        .step_by(4096)
        .map(|offset| {
            let chunk = content.slice(offset..content.len().min(offset + 4096));
            let chunk_crc32c = crc32c::crc32c(&chunk);
            v1::WriteBlobRequest {
                blob: (offset == 0).then(|| blob.clone()),
                offset: offset as u64,
                chunk,
                chunk_crc32c,
            }
        })
        .collect();
    let reply = connection
        .blobs()
        .write_blob(futures::stream::iter(messages))
        .await;
    reply.is_ok_and(|reply| reply.into_inner().committed_bytes == content.len() as u64)
}

fn read(path: &Path) -> Bytes {
    std::fs::read(path)
        .expect("the blob's file is readable")
        .into()
}

/// Chosen by the clock, and printed, so that runs differ and can be repeated.
fn kill_seed() -> u64 {
    let chosen = std::env::var("BACKLOT_KILL_SEED")
        .ok()
        .map(|seed| seed.parse().expect("BACKLOT_KILL_SEED is a number"));
    let clock = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .expect("the clock is past 1970");
    chosen.unwrap_or_else(|| u64::from(clock.subsec_nanos()))
}

/// SplitMix64 (Steele et al. 2014).
struct Draws(u64);

impl Draws {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % bound.max(1)
    }
}
