//! End-to-end tests through real sockets and real processes. One binary, so that everything is linked once.

#![allow(clippy::unwrap_used, reason = "a test that cannot unwrap has failed")]

mod main_path;

mod jobs;

mod mask_matching;

mod decompose;

mod segmenter;

mod bad_input;

mod data_dir;

mod container;

mod power_cut;

mod tidy;
