#!/usr/bin/env bash
# viser 1.1.1: beside rich 15, pip takes viser 0.2.23 without a word.
#
# 2026-11-30, Python 3.11, Linux x86-64, pip from the interpreter's ensurepip. viser 1.x asks for rich below 15;
# the releases of the 0.2 series name no upper bound. A project that pins rich 15, or has it from another program,
# and asks for "viser" gets the old viewer: no error and no warning, and code for 1.x then fails on what is not
# there, such as a server's initial camera. Asking for viser>=1 fails to resolve instead, and says why.
#
# Seen: with rich 15.0.0 viser 0.2.23, without it 1.1.1 and rich 14.3.4; "viser>=1" with it: no resolution.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
pip=("$folder/venv/bin/pip" install --quiet --disable-pip-version-check --dry-run)
chosen() {
    "${pip[@]}" --report - "$@" 2>/dev/null | "$folder/venv/bin/python" -c '
import json, sys
found = {entry["metadata"]["name"].lower(): entry["metadata"]["version"] for entry in json.load(sys.stdin)["install"]}
print(found["viser"], found["rich"])'
}
alone=$(chosen "viser<=1.1.1" "rich<=15.0.0")
beside=$(chosen "viser<=1.1.1" "rich==15.0.0")
echo "viser and rich, free: $alone; beside rich 15: $beside"
[ "$alone" = "1.1.1 14.3.4" ] || { echo "the free choice has changed"; exit 1; }
[ "$beside" = "0.2.23 15.0.0" ] || { echo "the choice beside rich 15 has changed"; exit 1; }
if "${pip[@]}" "viser>=1,<=1.1.1" "rich==15.0.0" 2>/dev/null; then
    echo "viser 1 takes rich 15 by now"
    exit 1
fi
