#!/usr/bin/env bash
# Builds the program from the source that the workflow came with, or from the folder NYSTROM_STREAM_SOURCE.
set -euo pipefail
cargo install --locked --path "${NYSTROM_STREAM_SOURCE:-$PWD}" --root "$CONDA_PREFIX"
