//! The GPU's kernels against the CPU's code, on whatever adapter is there (Mesa's lavapipe in CI).
//!
//! `BACKLOT_REQUIRE_ADAPTER=1` makes a missing adapter a failure; without it the tests pass and say on stderr what they left out.

mod adapter;

mod compare;

mod march;

mod stage_compare;

mod stages;

mod steps;

mod divergence;

mod cancel;

mod dense;

mod runs;

mod street;

mod compare_frames;

mod frame;

mod grid_compare;

mod grid_stages;

mod grid_steps;

mod grid_runs;
