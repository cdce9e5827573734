//! SIGKILL of the server during upload, training and publishing: nothing acknowledged is lost, and it starts again by itself.
//!
//! The normal run kills 6 times. The long form kills 20 times:
//! `cargo test -p backlot-e2e --test it power_cut -- --ignored --nocapture`; `BACKLOT_KILL_SEED=N` repeats a run.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use backlot_client::read_log::{BlobSource, ReadLog};
use backlot_client::{Connection, download, listing, watch};
use backlot_e2e::logs;
use backlot_e2e::server::{Server, free_port};
use backlot_proto::v1;

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
    kills_by_job: BTreeMap<String, u32>,
}

/// The server gives a job up whose process died five times under it: it may be the job's fault.
const KILLS_A_JOB: u32 = 4;
/// Jobs that may slip through a phase before the test gives up.
const JOBS_A_KILL: u32 = 4;

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
            kills_by_job: BTreeMap::new(),
        };
        for round in 0..kills.upload {
            campaign.kill_during_upload(round).await;
        }
        for _ in 0..kills.training {
            campaign.kill_during_job("training", "train").await;
        }
        for _ in 0..kills.publish {
            campaign.kill_during_job("publish", "publish").await;
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
        for (written, (digest, source)) in log.blobs.iter().enumerate() {
            if written == after {
                // The next write is on its way while the kill comes.
                let killed = server;
                let kill = async {
                    tokio::time::sleep(pause).await;
                    killed.kill();
                };
                let (acknowledged, ()) =
                    tokio::join!(write_blob(&connection, digest, source), kill);
                if acknowledged {
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

    /// Kills the server while the running job is in the phase. A job that gets past the phase unseen is replaced by another.
    async fn kill_during_job(&mut self, phase: &'static str, stage: &str) {
        // Publishing is short, training is not.
        let longest_ms = if phase == "publish" { 30 } else { 1500 };
        let pause = Duration::from_millis(self.draws.below(longest_ms));
        let (server, connection) = self.start().await;
        for _ in 0..JOBS_A_KILL {
            let name = self.unfinished_job(&connection).await;
            if reaches(&connection, &name, stage).await {
                tokio::time::sleep(pause).await;
                server.kill();
                *self.hits.entry(phase).or_default() += 1;
                *self.kills_by_job.entry(name).or_default() += 1;
                return;
            }
        }
        panic!(
            "seed {}: {JOBS_A_KILL} jobs went past {stage} unseen:\n{}",
            self.seed,
            server.log_text()
        );
    }

    /// A job that has not ended and may be killed once more; older ones are seen to their end first.
    async fn unfinished_job(&mut self, connection: &Connection) -> String {
        for name in self.acknowledged.jobs.clone() {
            let kills = self.kills_by_job.get(&name).copied().unwrap_or_default();
            let job = connection
                .jobs()
                .get_job(v1::GetJobRequest { name: name.clone() })
                .await;
            let job = job
                .expect("an acknowledged job is there")
                .into_inner()
                .job
                .expect("a reply holds a job");
            if !watch::is_finished(&job) && kills < KILLS_A_JOB {
                return name;
            }
            self.see_to_its_end(connection, &name).await;
        }
        let request = v1::CreateJobRequest {
            kind: v1::JobKind::Background.into(),
            drive_log: "driveLogs/log-0".to_owned(),
            budget: v1::Budget::Quick.into(),
            seed: self.acknowledged.jobs.len() as u64,
            ..Default::default()
        };
        let job = watch::create_job(connection, request)
            .await
            .expect("a running server takes jobs");
        self.acknowledged.jobs.insert(job.name.clone());
        job.name
    }

    async fn see_to_its_end(&mut self, connection: &Connection, name: &str) {
        let job = watch::watch_job(connection, name, |_| {})
            .await
            .expect("a job can be watched to its end");
        assert_eq!(
            job.state(),
            v1::JobState::Succeeded,
            "seed {}: {job:?}",
            self.seed
        );
        assert_eq!(
            job.assets.len(),
            1,
            "seed {}: one asset a job, however often it was begun: {job:?}",
            self.seed
        );
        let request = v1::GetAssetRequest {
            name: job.assets[0].clone(),
        };
        let asset = connection
            .assets()
            .get_asset(request)
            .await
            .expect("a finished job's asset is there");
        let asset = asset.into_inner().asset.expect("a reply holds an asset");
        self.acknowledged
            .assets
            .insert(asset.name, asset.payload.expect("assets have payloads"));
    }

    /// Every acknowledged job ends by itself, with one asset that can be read.
    async fn finish_every_job(&mut self) {
        let (_server, connection) = self.start().await;
        for name in self.acknowledged.jobs.clone() {
            self.see_to_its_end(&connection, &name).await;
        }
        let assets = listing::assets(&connection, v1::AssetKind::Unspecified, "")
            .await
            .expect("assets are listed");
        assert_eq!(
            assets.len(),
            self.acknowledged.jobs.len(),
            "seed {}: one asset a job",
            self.seed
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

/// Watches a job until it is in the stage; false if it ended first.
async fn reaches(connection: &Connection, name: &str, stage: &str) -> bool {
    let request = v1::WatchJobRequest {
        name: name.to_owned(),
    };
    let mut stream = connection
        .jobs()
        .watch_job(request)
        .await
        .expect("a job can be watched")
        .into_inner();
    while let Some(message) = stream.message().await.expect("the server is up") {
        let job = message.job.expect("a message holds a job");
        let running = job.state() == v1::JobState::Running;
        if running
            && job
                .progress
                .as_ref()
                .is_some_and(|progress| progress.stage == stage)
        {
            return true;
        }
    }
    false
}

/// Writes a blob in small chunks; false if the connection broke before the acknowledgement.
async fn write_blob(connection: &Connection, digest: &str, source: &BlobSource) -> bool {
    let content = source.read().expect("the blob is readable");
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
