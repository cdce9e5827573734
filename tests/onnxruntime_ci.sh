#!/usr/bin/env bash
# Runs the tests that need ONNX Runtime: its shared library is taken out of the Python package, in a throw-away environment.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

python3=$("$here/../client/python/kit_python.sh")
"$python3" -m venv "$scratch/venv"
export PIP_DISABLE_PIP_VERSION_CHECK=1
# The library alone: what the package needs from Python is left out.
"$scratch/venv/bin/python" -m pip install --quiet --no-deps 'onnxruntime==1.23.2'
libraries=("$scratch"/venv/lib/python*/site-packages/onnxruntime/capi/libonnxruntime.so.*)
export ORT_DYLIB_PATH=${libraries[0]}
cd "$here/.."
# The whole workspace, so that nothing is compiled again with other features.
cargo test --workspace --test it segmenter -- --ignored --nocapture
