#!/usr/bin/env bash
# Installs what is missing, builds the program and runs it: on three drives through an embedded town, or with your
# own arguments.
set -euo pipefail
root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
. "$root/third_party/setup.sh"

case "${1:-}" in
  -h | --help)
    cat <<TEXT
usage: examples/run.sh [--fresh]       simulate three drives through one town, map them into one with their GNSS
                                       fixes and without, check the results, write a report of each
       examples/run.sh SUBCOMMAND ...  build the program and run it: chainslam SUBCOMMAND ...
                                       (examples/run.sh help lists the subcommands)
environment: CHAINSLAM_BUILD_DIR (default: build/), CHAINSLAM_JOBS
TEXT
    exit 0 ;;
esac

# shellcheck disable=SC2086
install_packages $packages_build $packages_program
# A dozen files are one compilation: the headers that they share are compiled once for all of them.
configure_and_build release "the program" chainslam_program -DCMAKE_BUILD_TYPE=Release -DCMAKE_CXX_COMPILER=g++ \
  -DCMAKE_UNITY_BUILD=ON -DCMAKE_UNITY_BUILD_BATCH_SIZE=12 -DCHAINSLAM_BUILD_TESTS=OFF -DCHAINSLAM_BUILD_BENCH=OFF
program="$build/release/examples/chainslam"

if [ $# -gt 0 ] && [ "$1" != --fresh ]; then
  [ "$1" = help ] && set -- --help
  exec "$program" "$@"
fi

demo="$build/demo"
mkdir -p "$demo" || fail "cannot write to $demo; set CHAINSLAM_BUILD_DIR to a folder that can be written"
[ "${1:-}" = --fresh ] && rm -rf "$demo/town" "$demo"/map*
if [ -f "$demo/town/session3/README.txt" ]; then
  say "drives" "$demo/town exists from an earlier run (examples/run.sh --fresh makes it again)"
else
  "$program" simulate town-sessions --out "$demo/town" --overwrite || fail "the simulator stopped" $?
fi
rm -rf "$demo"/map*~* "$demo"/map*.partial*

# map_town NAME ARGUMENT...: maps the drives into $demo/NAME; what it prints is also in $demo/NAME.log.
map_town() {
  local name="$1" status=0
  shift
  "$program" map "$demo"/town/session{1,2,3} --out "$demo/$name" --overwrite --config "$root/examples/town.toml" "$@" |
    tee "$demo/$name.log" || status=$?
  case $status in
    0) say "passed" "the map meets the bounds of examples/town.toml" ;;
    5) fail "the map misses a bound of examples/town.toml; see $demo/$name/summary.json" 5 ;;
    *) fail "the mapper stopped with exit code $status" "$status" ;;
  esac
}

# compare NAME LABEL: in how many frames the sessions are, the errors, what joins each two sessions, and the report.
compare() {
  awk -v label="$2" '
    /^sessions / { frames = $2 " sessions in " $4 " frame" ($4 == 1 ? "" : "s") }
    /^error / { error = $2 " m" }
    / between keyframes of different sessions/ { between = $1 " m" }
    END { printf "%-12s %s, error %s, %s between sessions\n", label, frames, error, between }' "$demo/$1.log"
  "$program" inspect "$demo/$1/map.cslam" | sed -nE 's/^ *(sessions [0-9]+ and [0-9]+) +joined by +/             \1: /p'
  say "" "$demo/$1/report.html"
}

map_town map
say "again" "without GNSS fixes: sessions are merged by what their scans look like"
map_town map_without_gnss --set dataset.gnss=none
say "comparison" "error: against the ground truth, RMS; between sessions: of keyframes at one place"
compare map "with GNSS"
compare map_without_gnss "without"
