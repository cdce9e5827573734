//! Segmentation models in real runtimes: networks that the tests write themselves, on logs whose right masks are known.
//!
//! tract runs them in every test run. ONNX Runtime needs its shared library, so those tests are ignored unless asked for:
//! `tests/onnxruntime_ci.sh` installs it and asks.

mod networks;

mod score;

mod runtimes;

mod refusals;

mod jobs;
