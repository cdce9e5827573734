#!/usr/bin/env bash
# Checks the Python package in a throw-away environment: ci.sh [PROGRAMS], where PROGRAMS is a folder with backlotd and backlot.
# With PROGRAMS, or with BACKLOT_SERVER and BACKLOT_BACKGROUND set, the end-to-end test runs too.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
if [ $# -gt 0 ]; then exec "$here/with_street.sh" "$1" "$here/ci.sh"; fi
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

python3 -m venv "$scratch/venv"
python=$scratch/venv/bin/python
export PIP_DISABLE_PIP_VERSION_CHECK=1
"$python" -m pip install --quiet "$here[test]" 'ruff==0.17.6'
"$python" -m ruff check --quiet --no-cache "$here"
"$python" -m ruff format --quiet --no-cache --check "$here"

# The installed package, not the source folder, is what is tested.
cd "$scratch"
"$python" -m pytest -q -p no:cacheprovider -c "$here/pyproject.toml" --rootdir "$here" "$here/tests"
