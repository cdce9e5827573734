//! End-to-end tests through real sockets and real processes. One binary, so that everything is linked once.

mod main_path;

mod jobs;

mod bad_input;

mod data_dir;

mod container;

mod power_cut;

mod tidy;
