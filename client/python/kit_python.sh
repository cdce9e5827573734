#!/usr/bin/env bash
# Names a Python that the data sets' development kits run on: nuscenes-devkit needs numpy 1, which has no wheels from Python 3.13
# on; the pinned scipy has none before 3.11.
set -euo pipefail
for candidate in python3 python3.12 python3.11; do
  if command -v "$candidate" >/dev/null && "$candidate" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 13))'; then
    echo "$candidate"
    exit 0
  fi
done
echo "the data sets' development kits need Python 3.11 or 3.12" >&2
exit 1
