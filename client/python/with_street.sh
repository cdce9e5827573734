#!/usr/bin/env bash
# Runs a command against a server that holds a trained street: with_street.sh PROGRAMS COMMAND..., where PROGRAMS is a folder with
# backlotd and backlot. The command finds BACKLOT_SERVER and BACKLOT_BACKGROUND set.
set -euo pipefail
programs=$(cd "$1" && pwd)
shift
scratch=$(mktemp -d)
server_pid=
cleanup() {
  if [ -n "$server_pid" ]; then kill "$server_pid" 2>/dev/null || true; wait "$server_pid" 2>/dev/null || true; fi
  rm -rf "$scratch"
}
trap cleanup EXIT

start_server() {
  local port
  port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
  export BACKLOT_SERVER=http://127.0.0.1:$port
  "$programs/backlotd" --data-dir "$scratch/data" --listen "127.0.0.1:$port" >"$scratch/server.log" 2>&1 &
  server_pid=$!
  for _ in $(seq 100); do
    if "$programs/backlot" logs list >/dev/null 2>&1; then return; fi
    sleep 0.1
  done
  cat "$scratch/server.log" >&2
  return 1
}

train() {
  "$programs/backlot" logs upload --format generated --name street --seed 7 --frames 20 --width 320 --height 192 --travel-m 24
  "$programs/backlot" jobs submit background --log street --budget quick --watch
  "$programs/backlot" jobs submit objects --log street --budget quick --watch
}

start_server
train >"$scratch/train.log" 2>&1 || { cat "$scratch/train.log" "$scratch/server.log" >&2; exit 1; }
BACKLOT_BACKGROUND=$("$programs/backlot" assets list --kind background --output json |
  python3 -c 'import json, sys; print(json.load(sys.stdin)[0]["name"])')
export BACKLOT_BACKGROUND
"$@"
