#!/usr/bin/env bash
# Writes labels in every format and reads them back with other people's readers, in a throw-away environment: formats_ci.sh PROGRAMS,
# where PROGRAMS is a folder with backlotd and backlot. Uses the server of BACKLOT_SERVER and BACKLOT_BACKGROUND if they are set.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
programs=$(cd "$1" && pwd)
if [ -z "${BACKLOT_SERVER:-}" ]; then exec "$here/with_street.sh" "$programs" "$here/formats_ci.sh" "$programs"; fi
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

python3=$("$here/kit_python.sh")
"$python3" -m venv "$scratch/venv"
python=$scratch/venv/bin/python
export PIP_DISABLE_PIP_VERSION_CHECK=1
"$python" -m pip install --quiet -r "$here/formats/requirements.txt"
# Waymo's own package pins TensorFlow, which its table schemas do not need.
"$python" -m pip install --quiet --no-deps 'waymo-open-dataset-tf-2-12-0==1.6.7'

augment() {
  local name=$1
  shift
  "$programs/backlot" augment --background "$BACKLOT_BACKGROUND" --out "$scratch/sets/$name" --labels kitti,json,coco,nuscenes,waymo "$@"
}
augment images --count 4 --seed 5
augment removed --count 2 --seed 6 --drop-originals --max-objects 1
augment clips --count 2 --seed 7 --clip-frames 5 --clip-stride 2 --speed 2..5 --longer-side 160

cd "$scratch"
BACKLOT_SETS=$scratch/sets "$python" -m pytest -q -p no:cacheprovider --rootdir "$here/formats" -c /dev/null "$here/formats"
