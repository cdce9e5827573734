#!/bin/sh
# Starts backlotd with the image's configuration; arguments are added and win over it.
# BACKLOT_CONFIG names another file. `exec`: the server is process 1 of its container and gets its signals.
set -eu
exec "${BACKLOTD:-backlotd}" --config "${BACKLOT_CONFIG:-/etc/backlot/server.toml}" "$@"
