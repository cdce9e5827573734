//! What each stage took.

use std::time::Instant;

/// Wall-clock seconds by stage, in the order in which they ran.
#[derive(Debug, Default)]
pub(crate) struct Stages {
    seconds: Vec<(&'static str, f64)>,
}

impl Stages {
    pub(crate) async fn time<T>(
        &mut self,
        stage: &'static str,
        work: impl Future<Output = T>,
    ) -> T {
        let start = Instant::now();
        let result = work.await;
        self.seconds.push((stage, start.elapsed().as_secs_f64()));
        result
    }

    /// Work that keeps the cores busy and never waits.
    pub(crate) fn time_blocking<T>(&mut self, stage: &'static str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = tokio::task::block_in_place(work);
        self.seconds.push((stage, start.elapsed().as_secs_f64()));
        result
    }

    pub(crate) fn to_json(&self) -> serde_json::Value {
        let rounded = |s: f64| (s * 1000.0).round() / 1000.0;
        let entries = self.seconds.iter();
        serde_json::Value::Object(
            entries
                .map(|(stage, seconds)| ((*stage).to_owned(), rounded(*seconds).into()))
                .collect(),
        )
    }

    pub(crate) fn total(&self) -> f64 {
        self.seconds.iter().map(|(_, seconds)| seconds).sum()
    }
}
