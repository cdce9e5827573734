#!/usr/bin/env bash
# Opens the data sets that `cargo test --test datasets` wrote with the data sets' own development kits: ci.sh DATASETS_FOLDER.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
datasets=$(cd "$1" && pwd)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

python3=$("$here/../../python/kit_python.sh")
"$python3" -m venv "$scratch/venv"
python=$scratch/venv/bin/python
export PIP_DISABLE_PIP_VERSION_CHECK=1
"$python" -m pip install --quiet --requirement "$here/requirements.txt"
"$python" -m pip install --quiet --no-deps 'nuscenes-devkit==1.2.0' 'av2==0.3.6'
"$python" "$here/read_by_others.py" "$datasets"
