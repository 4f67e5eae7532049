#!/bin/sh
# Writes /data/own/service.toml for the server of SOURCE_URL, once; arguments are options of
# `valvemap connect`. Without SOURCE_URL there is nothing to do: the service uses the rig.
set -eu
own="${VALVEMAP_DATA:-/data}/own"
if [ -z "${SOURCE_URL:-}" ]; then exit 0; fi
if [ -f "$own/service.toml" ] && [ $# -eq 0 ]; then exit 0; fi
mkdir -p "$own"
exec valvemap connect "$SOURCE_URL" --out "$own/service.toml" \
    ${SOURCE_USER:+--user "$SOURCE_USER"} "$@"
