#!/usr/bin/env bash
# Installs what is missing, builds the programs and makes the tables of the paper: see README.md beside this file.
set -euo pipefail
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)"
. "$root/third_party/setup.sh"

python="$(debian_python)"
export PYTHONPATH="$root/bench" PYTHONDONTWRITEBYTECODE=1
command -v "$python" >/dev/null || install_packages python3
"$python" -m experiments --check "$@"  # before anything is installed or built
for word in "$@"; do case "$word" in -h | --help) exit 0 ;; esac; done

# shellcheck disable=SC2086
install_packages $packages_build $packages_program $packages_bench $packages_experiments
# As examples/run.sh builds it, and in the same folder.
configure_and_build release "the program" chainslam_program -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_COMPILER=g++ \
  -DCMAKE_UNITY_BUILD=ON -DCMAKE_UNITY_BUILD_BATCH_SIZE=12 -DCHAINSLAM_BUILD_TESTS=OFF -DCHAINSLAM_BUILD_BENCH=OFF
configure_and_build bench "LAMM, drawn graphs, streets, views" "graph_seeds street_registration viewpoints lamm" \
  -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_COMPILER=g++ -DCHAINSLAM_BUILD_TESTS=OFF
unpack_data
exec "$python" -m experiments "$@" --program "$build/release/examples/chainslam" --lamm "$build/bench/bench/lamm" \
  --graph-seeds "$build/bench/bench/graph_seeds" --street-registration "$build/bench/bench/street_registration" \
  --viewpoints "$build/bench/bench/viewpoints"
